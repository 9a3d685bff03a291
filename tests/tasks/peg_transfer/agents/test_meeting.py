"""Where a block is handed over: both arms have room, whichever arm gives."""

from dataclasses import replace

import numpy as np
import pytest
from trocar.tasks.peg_transfer.agents.settings import Settings

from simulated import ARM_MODELS, T_WORLD_BASE
from trocar.arms import capsules, ik
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.tasks.peg_transfer.agents.meeting import ROOM_M, Offer, Partner, Ways, choose_offer, choose_taking
from trocar.tasks.peg_transfer.grasps import Grasp, grasp_candidates, held_block
from trocar.tasks.peg_transfer.shapes import Block

SETTINGS, BLOCK = Settings(), Block()
WAYS = Ways(SETTINGS.waits_above_m, SETTINGS.parts_m, SETTINGS.depth_m, BLOCK.wall_middle_m)
HELD_RAD = 0.18


def partner(name: str) -> Partner:
    return Partner(ARM_MODELS[name], T_WORLD_BASE[name], SETTINGS.taking_rad, HELD_RAD)


def held_at_the_outer_wall(giver: str, candidate: int) -> SE3:
    """Return ``T_tip_block`` of a block that an arm holds at the wall on its own side: there its tool is not turned."""
    turned = SE3.from_parts(SO3.axis("z", np.pi if giver == "psm1" else 0.0))
    return held_block(SE3.identity(), (grasp_candidates(SETTINGS.depth_m)[candidate] @ turned).inverse(), BLOCK)


@pytest.mark.parametrize(("giver", "receiver"), [("psm1", "psm2"), ("psm2", "psm1")])
@pytest.mark.parametrize("candidate", [0, 1])
@pytest.mark.parametrize("yaw_deg", [130.0, 180.0, 230.0])
def test_a_block_held_at_its_outer_wall_can_be_taken_with_room(giver, receiver, candidate, yaw_deg):
    T_tip_block = held_at_the_outer_wall(giver, candidate)
    now = SE3.from_parts(SO3.axis("z", np.radians(yaw_deg)))
    middle = np.array(SETTINGS.meeting_m)
    gives, takes = partner(giver), partner(receiver)
    offer = choose_offer(gives, takes, SE3.identity(), now, T_tip_block, BLOCK, middle, WAYS)
    assert isinstance(offer, Offer) and offer.room_m >= ROOM_M
    T_board_block = offer.T_board_tip @ T_tip_block
    assert np.allclose(T_board_block.translation_m, middle + [0, 0, BLOCK.height_m])
    grasp = choose_taking(gives, takes, SE3.identity(), T_board_block, offer.T_board_tip, WAYS)
    assert isinstance(grasp, Grasp)
    assert np.linalg.norm(grasp.T_board_tip.translation_m - offer.T_board_tip.translation_m) > 7e-3
    q = ik(gives.model, gives.T_world_base.inverse() @ offer.T_board_tip)
    holding = capsules(gives.model, q, HELD_RAD).moved(gives.T_world_base)
    taking = capsules(takes.model, grasp.q, SETTINGS.taking_rad).moved(takes.T_world_base)
    assert capsule_distances_m(taking, holding).min() >= grasp.clearance_m - 1e-9 >= SETTINGS.meeting_margin_m


def test_a_meeting_out_of_reach_is_a_sentence():
    T_tip_block = held_at_the_outer_wall("psm2", 0)
    far = np.array([0.5, 0.0, 0.04])
    gives, takes = partner("psm2"), partner("psm1")
    answer = choose_offer(gives, takes, SE3.identity(), SE3.identity(), T_tip_block, BLOCK, far, WAYS)
    assert isinstance(answer, str) and "both arms" in answer


def test_arms_that_would_come_too_near_do_not_take():
    T_tip_block, now = held_at_the_outer_wall("psm2", 0), SE3.from_parts(SO3.axis("z", np.pi))
    gives, takes = partner("psm2"), partner("psm1")
    offer = choose_offer(gives, takes, SE3.identity(), now, T_tip_block, BLOCK, np.array(SETTINGS.meeting_m), WAYS)
    assert isinstance(offer, Offer)
    T_board_block = offer.T_board_tip @ T_tip_block
    best = choose_taking(gives, takes, SE3.identity(), T_board_block, offer.T_board_tip, WAYS)
    assert isinstance(best, Grasp)
    wide = replace(takes, open_rad=takes.open_rad + 2 * np.arcsin(best.clearance_m / takes.model.tip_length_m))
    answer = choose_taking(gives, wide, SE3.identity(), T_board_block, offer.T_board_tip, WAYS)
    assert isinstance(answer, str) and "between them" in answer
