"""Where a block is handed over: both arms have room, whichever arm gives; and what their scripts tell each other."""

from dataclasses import replace
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest
import trio

from simulated import ARM_MODELS, T_WORLD_BASE
from trocar.arms import capsules, fk, ik
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.agents.meeting import (
    MIN_ROOM_M,
    ROOM_M,
    HandoverGeometry,
    HandoverState,
    Offer,
    Partner,
    Side,
)
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp, grasp_candidates, held_block
from trocar.tasks.peg_transfer.shapes import Block

SETTINGS, BLOCK = Settings(), Block()
HELD_RAD = 0.18


def between(giver: str, receiver: str, settings=SETTINGS, ways_m=()) -> HandoverGeometry:
    bases = {name: T_WORLD_BASE[name] for name in (giver, receiver)}
    gives, takes = (
        Partner(ARM_MODELS[name], base, base, SETTINGS.taking_rad, HELD_RAD) for name, base in bases.items()
    )
    return HandoverGeometry(gives, takes, SE3.identity(), BLOCK, settings, np.reshape(ways_m, (-1, 2)))


def held_at_the_outer_wall(giver: str, candidate: int) -> SE3:
    """Return ``T_tip_block`` of a block that an arm holds at the wall on its own side: there its tool is not turned."""
    turned = SE3.from_parts(SO3.axis("z", np.pi if giver == "psm1" else 0.0))
    return held_block(SE3.identity(), (grasp_candidates(SETTINGS.depth_m)[candidate] @ turned).inverse(), BLOCK)


def offered(geometry, T_tip_block, yaw_deg=180.0):
    offer = geometry.choose_offer(SE3.from_parts(SO3.axis("z", np.radians(yaw_deg))), T_tip_block)
    assert isinstance(offer, Offer)
    return offer, offer.T_board_tip @ T_tip_block


@pytest.mark.parametrize(("giver", "receiver"), [("psm1", "psm2"), ("psm2", "psm1")])
@pytest.mark.parametrize("candidate", [0, 1])
@pytest.mark.parametrize("yaw_deg", [130.0, 180.0, 230.0])
def test_a_block_held_at_its_outer_wall_can_be_taken_with_room(giver, receiver, candidate, yaw_deg):
    geometry = between(giver, receiver)
    offer, T_board_block = offered(geometry, held_at_the_outer_wall(giver, candidate), yaw_deg)
    assert offer.room_m >= ROOM_M
    assert np.allclose(T_board_block.translation_m, np.array(SETTINGS.meeting_m) + [0, 0, BLOCK.height_m])
    grasp = geometry.choose_taking(T_board_block, offer.T_board_tip)
    assert isinstance(grasp, Grasp)
    assert np.linalg.norm(grasp.T_board_tip.translation_m - offer.T_board_tip.translation_m) > 7e-3
    gives, takes = geometry.giver, geometry.receiver
    at_grasp = takes.T_world_base @ fk(takes.model, grasp.q)
    assert np.allclose(at_grasp.matrix, grasp.T_board_tip.matrix, atol=1e-6)
    q = ik(gives.model, gives.T_world_base.inverse() @ offer.T_board_tip)
    holding = capsules(gives.model, q, HELD_RAD).moved(gives.T_world_base)
    taking = capsules(takes.model, grasp.q, SETTINGS.taking_rad).moved(takes.T_world_base)
    assert capsule_distances_m(taking, holding).min() >= grasp.clearance_m - 1e-9 >= SETTINGS.meeting_margin_m


@pytest.mark.parametrize("yaw_deg", [60.0, 130.0, 180.0])
def test_a_tool_that_leaves_room_where_it_is_does_not_turn(yaw_deg):
    geometry, T_tip_block = between("psm2", "psm1"), held_at_the_outer_wall("psm2", 0)
    offer, _ = offered(geometry, T_tip_block, yaw_deg)
    again = geometry.choose_offer(offer.T_board_tip, T_tip_block)
    assert isinstance(again, Offer)
    assert np.allclose(again.T_board_tip.matrix, offer.T_board_tip.matrix, atol=1e-9)


def test_a_grasp_that_failed_is_avoided_and_one_near_the_tip_is_near_it():
    geometry = between("psm2", "psm1")
    offer, T_board_block = offered(geometry, held_at_the_outer_wall("psm2", 0))
    best = geometry.choose_taking(T_board_block, offer.T_board_tip)
    assert isinstance(best, Grasp)
    other = geometry.choose_taking(T_board_block, offer.T_board_tip, avoid=[best.candidate])
    assert isinstance(other, Grasp) and other.candidate != best.candidate and other.clearance_m <= best.clearance_m
    for grasp in (best, other):
        above = SE3.from_parts(translation_m=[2e-3, -2e-3, 13e-3]) @ grasp.T_board_tip
        near = geometry.choose_taking(T_board_block, offer.T_board_tip, near=above)
        assert isinstance(near, Grasp)
        assert np.linalg.norm((near.T_board_tip.translation_m - above.translation_m)[:2]) < 4e-3
        assert np.linalg.norm((near.T_board_tip.rotation.inverse() @ above.rotation).log()) < np.radians(20.0)
    away = SE3.from_parts(translation_m=[0.03, 0.0, 0.0]) @ best.T_board_tip
    assert "in reach" in geometry.choose_taking(T_board_block, offer.T_board_tip, near=away)


def test_a_meeting_out_of_reach_is_a_sentence():
    geometry = between("psm2", "psm1", replace(SETTINGS, meeting_m=(0.5, 0.0, 0.04)))
    answer = geometry.choose_offer(SE3.identity(), held_at_the_outer_wall("psm2", 0))
    assert isinstance(answer, str) and "both arms" in answer


def test_arms_that_would_come_too_near_do_not_take():
    geometry = between("psm2", "psm1")
    offer, T_board_block = offered(geometry, held_at_the_outer_wall("psm2", 0))
    best, takes = geometry.choose_taking(T_board_block, offer.T_board_tip), geometry.receiver
    assert isinstance(best, Grasp)
    wide = replace(takes, open_rad=takes.open_rad + 2 * np.arcsin(best.clearance_m / takes.model.tip_length_m))
    answer = replace(geometry, receiver=wide).choose_taking(T_board_block, offer.T_board_tip)
    assert isinstance(answer, str) and "between them" in answer


# What the scripts tell each other.


def test_before_a_meeting_nothing_is_known_and_nobody_has_had_the_block():
    meeting = HandoverState(Transfer(0, 6), "psm1")
    told = (meeting.announced, meeting.begun, meeting.crowded, meeting.offered, meeting.taken, meeting.released)
    told += (meeting.parted,)
    assert not meeting.passed and meeting.outcome is None and not any(event.is_set() for event in told)


def test_who_announces_tells_where_the_block_will_be():
    meeting = HandoverState(Transfer(0, 6), "psm1")
    T_board_tip, T_tip_block = SE3.exp([0.01, 0.02, 0.05, 0.3, 0.0, 0.2]), SE3.exp([0.0, 0.0, 0.01, 0.0, 0.1, 0.0])
    meeting.announce(T_board_tip, T_tip_block)
    assert meeting.announced.is_set() and not meeting.offered.is_set() and meeting.T_board_giver is T_board_tip
    np.testing.assert_allclose(meeting.T_board_block.matrix, (T_board_tip @ T_tip_block).matrix)


def test_a_meeting_fails_once_and_then_neither_arm_waits_for_the_other():
    meeting = HandoverState(Transfer(0, 6), "psm1")
    meeting.fail(TransferOutcome.DROPPED, "it slipped")
    meeting.fail(TransferOutcome.NOT_GRASPED, "nothing was there")
    assert (meeting.outcome, meeting.reason) == (TransferOutcome.DROPPED, "it slipped")
    told = (meeting.announced, meeting.begun, meeting.crowded, meeting.offered, meeting.taken, meeting.released)
    told += (meeting.parted,)
    assert all(event.is_set() for event in told) and not meeting.passed


class Shifted:
    """Stands for an arm of this laboratory; notes how it was told to shift."""

    def __init__(self, name):
        self.cell, self.settings, self.table, self.shifts = None, SETTINGS, None, []
        self.motions = SimpleNamespace(T_base_board=T_WORLD_BASE[name].inverse())

    async def shift(self, line_m, margin_m, contact_s, waits):
        self.shifts.append((line_m, margin_m, contact_s))


@pytest.mark.parametrize(("name", "side"), [("psm1", 1.0), ("psm2", -1.0)])
def test_an_arm_rises_straight_out_of_a_block_that_touches_the_other_arm_all_the_way(name, side):
    arm = Shifted(name)
    trio.run(Side(arm, None, None).rise)
    assert arm.shifts == [((0.0, 0.0, SETTINGS.parts_m), SETTINGS.meeting_margin_m, (0.0, inf))]
    assert Side(arm, None, None).own_side == side == np.sign(T_WORLD_BASE[name].translation_m[0])


@pytest.mark.parametrize(("giver", "receiver"), [("psm1", "psm2"), ("psm2", "psm1")])
def test_a_block_is_offered_so_that_the_receiving_arm_is_out_of_the_giving_ones_way(giver, receiver):
    def receiver_off_m(ways_m):
        geometry = between(giver, receiver, ways_m=ways_m)
        offer, T_board_block = offered(geometry, held_at_the_outer_wall(giver, 0))
        grasp = geometry.choose_taking(T_board_block, offer.T_board_tip)
        assert isinstance(grasp, Grasp) and offer.room_m > MIN_ROOM_M
        return (grasp.T_board_tip.translation_m - offer.T_board_tip.translation_m)[:2]

    free_m = receiver_off_m(())
    behind = np.array([0.0, 40e-3 * np.sign(free_m[1])])  # where it stands, seen from the giving arm
    assert free_m @ behind > 0 > receiver_off_m(behind) @ behind


def test_room_counts_before_the_way():
    geometry, here = between("psm1", "psm2", ways_m=[(40e-3, 0.0)]), SE3.identity()
    ahead, aside = (SE3.from_parts(translation_m=[x, 0.0, 0.0]) for x in (9e-3, -9e-3))
    assert geometry._preference_m(2.4e-3, ahead, here) < geometry._preference_m(2.3e-3, aside, here)
    assert geometry._preference_m(1.2e-3, ahead, here) >= MIN_ROOM_M > geometry._preference_m(0.9e-3, aside, here)
