"""Where a block is grasped, and where a held one is released."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated import standing
from trocar.arms import PSM_CLASSIC, fk, frames
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.grasps import (
    FINGER_ROOM_M,
    NEAR_END_M,
    Grasp,
    choose_grasp,
    choose_place,
    grasp_candidates,
    held_block,
)
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

BOARD, BLOCK = Pegboard(), Block()
OVER = SE3.from_parts(translation_m=[0.0, 0.0, -0.17])
"""T_base_board: remote centre 170 mm above the board's middle."""
ASIDE = SE3.from_parts(SO3.axis("z", np.pi), [0.1332, 0.0, 0.166]).inverse()
DROP_M = 2e-3
SEEDS = st.integers(0, 2**32 - 1)


def grasped(T_board_block, T_base_board=ASIDE, arm=PSM_CLASSIC, **how):
    grasp = choose_grasp(arm, T_base_board, T_board_block, BOARD, BLOCK, **how)
    assert isinstance(grasp, Grasp), grasp
    return grasp


def placed(peg, T_tip_block, others=(), T_base_board=ASIDE):
    return choose_place(PSM_CLASSIC, T_base_board, T_tip_block, BOARD, BLOCK, peg, others, DROP_M)


def held(yaw_rad=0.4):
    """Return ``T_tip_block`` of a block grasped round its wall."""
    block = standing(1, (0.6e-3, -0.4e-3), yaw_rad)
    return held_block(grasped(block).T_board_tip, block, BLOCK)


def wrist_is_free(q):
    limits = ((j.lower + np.radians(5.0), j.upper - np.radians(5.0)) for j in PSM_CLASSIC.joints[4:])
    inside = all(low <= value <= high for value, (low, high) in zip(q[4:], limits, strict=True))
    return inside and abs(q[3]) <= np.radians(70.0) + 1e-12


def in_the_wall(p_block_m):
    """Return which points (..., 3) in the block's frame lie inside its walls, seen from above."""
    radius, angle = np.hypot(p_block_m[..., 0], p_block_m[..., 1]), np.arctan2(p_block_m[..., 1], p_block_m[..., 0])
    return (BLOCK.hole_radius_m(angle) < radius) & (radius < BLOCK.outer_radius_m(angle))


def test_candidates_lie_in_the_walls_and_point_out_of_the_block():
    grasps = grasp_candidates()
    assert in_the_wall(grasps.translation_m).all()
    assert np.allclose(grasps.matrix[:, :3, 2], [0, 0, -1])
    assert np.allclose(np.linalg.det(grasps.matrix[:, :3, :3]), 1)


def test_jaws_open_along_the_tips_x():
    q = np.array([0.1, -0.2, 0.12, 0.4, 0.2, -0.3])
    axis = frames(PSM_CLASSIC, q).matrix[6, :3, 2]  # of joint 6, that the jaws turn about
    assert np.allclose(np.abs(fk(PSM_CLASSIC, q).matrix[:3, :3].T @ axis), [0, 1, 0])


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_the_choice_keeps_every_promise(seed):
    rng = np.random.default_rng(seed)
    peg = int(rng.integers(12))
    T = standing(peg, rng.uniform(-1e-3, 1e-3, 2), rng.uniform(0, 2 * np.pi))
    grasp = grasped(T, OVER)
    assert np.abs(fk(PSM_CLASSIC, grasp.q).matrix - (OVER @ grasp.T_board_tip).matrix).max() < 1e-9
    assert np.allclose(grasp.T_board_tip.matrix[:3, 2], [0, 0, 1]) and wrist_is_free(grasp.q)
    half_m = PSM_CLASSIC.instrument.finger_thickness_m(NEAR_END_M) / 2
    face = PSM_CLASSIC.tip_length_m * np.sin(grasp.jaw_rad / 2)
    for side in (-1, 1):  # the finger's middle is free of peg and wall by half its thickness and the clearance
        middle = grasp.T_board_tip.apply([side * (face + half_m), 0, 0])
        peg_gap = np.linalg.norm(middle[:2] - BOARD.pegs_m[peg][:2]) - BOARD.peg_radius_m
        assert peg_gap >= grasp.clearance_m + half_m - 1e-9
        assert not in_the_wall(T.inverse().apply(middle))


@pytest.mark.parametrize("yaw_rad", np.radians([0, 40, 80, 200]))
def test_takes_the_wall_farthest_from_the_peg_and_another_one_if_that_has_failed(yaw_rad):
    T = standing(3, 1.5e-3 * np.array([-np.sin(yaw_rad), -np.cos(yaw_rad)]), yaw_rad)  # one wall is far from the peg
    grasp = grasped(T, OVER, max_roll_rad=np.pi)
    away_m = np.linalg.norm((T @ grasp_candidates()).translation_m - BOARD.pegs_m[3], axis=-1)
    assert away_m[grasp.candidate] > np.sort(away_m)[-3]
    again = grasped(T, OVER, max_roll_rad=np.pi, avoid=(grasp.candidate,))
    assert again.candidate != grasp.candidate


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_only_walls_on_the_side_that_is_asked_for_are_grasped(sign):
    side = np.array([sign, 0.0])
    grasp = grasped(standing(1), OVER, max_roll_rad=np.pi, towards=side)
    assert (grasp.T_board_tip.translation_m - BOARD.pegs_m[1])[:2] @ side > 1e-3


def test_a_neighbour_that_touches_the_wall_blocks_it():
    T = standing(1)
    alone = grasped(T, OVER)
    outward = alone.T_board_tip.translation_m - T.translation_m
    outward = np.array([*outward[:2], 0.0]) / np.linalg.norm(outward[:2])
    beside = SE3.from_parts(T.rotation, T.translation_m + 13e-3 * outward)
    moved = choose_grasp(PSM_CLASSIC, OVER, T, BOARD, BLOCK, [T, beside])
    assert isinstance(moved, str) or moved.candidate // 2 != alone.candidate // 2


def test_says_why_there_is_none():
    far = SE3.from_parts(translation_m=[1.0, 0.0, -0.1])
    answer = choose_grasp(PSM_CLASSIC, far, standing(0), BOARD, BLOCK)
    assert isinstance(answer, str) and "out of reach" in answer
    with pytest.raises(TrocarError, match="one finite pose"):
        choose_grasp(PSM_CLASSIC, OVER, SE3.identity((2,)), BOARD, BLOCK)


def test_a_thicker_instrument_has_less_room():
    gaps = []
    for finger_tip_m in (1.0e-3, 1.4e-3):
        instrument = replace(PSM_CLASSIC.instrument, finger_tip_m=finger_tip_m)
        gaps.append(grasped(standing(1), OVER, replace(PSM_CLASSIC, instrument=instrument)).clearance_m)
    assert 0.1e-3 < gaps[0] - gaps[1] < 0.4e-3  # of one finger at most what both could take away


# Places.


@settings(max_examples=25, deadline=None)
@given(peg=st.integers(0, 11), yaw=st.floats(-np.pi, np.pi))
def test_the_block_ends_upright_over_its_peg_with_room_for_the_inner_finger(peg, yaw):
    T_tip_block = held(yaw)
    place = placed(peg, T_tip_block)
    assert isinstance(place, SE3), place
    T_board_block = place @ T_tip_block
    off = T_board_block.translation_m[:2] - BOARD.pegs_m[peg, :2]
    to_tip = place.translation_m[:2] - T_board_block.translation_m[:2]
    assert np.linalg.norm(off) == pytest.approx(FINGER_ROOM_M, abs=1e-6)
    assert off @ to_tip > 0.9 * np.linalg.norm(off) * np.linalg.norm(to_tip)
    assert T_board_block.translation_m[2] - BLOCK.height_m == pytest.approx(BOARD.pegs_m[peg, 2] + DROP_M, abs=1e-6)
    assert T_board_block.matrix[2, 2] == pytest.approx(-1.0, abs=1e-9)
    assert place.matrix[2, 2] == pytest.approx(1.0, abs=1e-9)


def test_the_open_finger_turns_away_from_a_neighbour():
    T_tip_block = held()
    alone = placed(8, T_tip_block)
    assert isinstance(alone, SE3)
    outwards = alone.rotation.apply([-np.sign(T_tip_block.translation_m[0]), 0.0, 0.0])[:2]
    middle = BOARD.pegs_m[8, :2] + 16.5e-3 * outwards
    neighbour = SE3.from_parts(SO3(np.diag([1.0, -1.0, -1.0])), [*middle, BLOCK.height_m])
    beside = placed(8, T_tip_block, [neighbour])
    assert isinstance(beside, SE3)
    assert np.linalg.norm((alone.rotation.inverse() @ beside.rotation).log()) > np.radians(5.0)
    assert BLOCK.gap_m(beside @ T_tip_block, neighbour) > 0.0


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5, -2.0])
def test_a_tool_does_not_turn_where_it_need_not(yaw_rad):
    """A tool that has the yaw at which a block can be released keeps it."""
    T_tip_block = held()
    first = choose_place(PSM_CLASSIC, ASIDE, T_tip_block, BOARD, BLOCK, 3, [], DROP_M, yaw_rad)
    assert isinstance(first, SE3)
    now_rad = float(np.arctan2(first.matrix[1, 0], first.matrix[0, 0]))
    again = choose_place(PSM_CLASSIC, ASIDE, T_tip_block, BOARD, BLOCK, 3, [], DROP_M, now_rad)
    assert isinstance(again, SE3)
    np.testing.assert_allclose(again.matrix, first.matrix, atol=1e-9)


def test_a_board_out_of_reach_is_a_sentence():
    answer = placed(3, held(), T_base_board=SE3.from_parts(translation_m=[0.0, 0.0, -0.5]) @ ASIDE)
    assert answer == "no pose over peg 3 keeps the roll and the wrist within their limits"


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_the_jaws_centre_the_wall_between_them(seed):
    rng = np.random.default_rng(seed)
    block = standing(2, rng.uniform(-1e-3, 1e-3, 2), rng.uniform(-np.pi, np.pi))
    grasp = choose_grasp(PSM_CLASSIC, ASIDE, block, BOARD, BLOCK)
    if not isinstance(grasp, Grasp):
        return
    T_tip_block = held_block(grasp.T_board_tip, block, BLOCK)
    before, after = (grasp.T_board_tip.inverse() @ block).matrix, T_tip_block.matrix
    assert np.allclose(after[:3, :3], before[:3, :3]) and np.allclose(after[1:3, 3], before[1:3, 3])
    assert abs(after[0, 3] - before[0, 3]) < 1.2e-3
    across = np.linspace(-2.0e-3, 2.0e-3, 401)
    points = T_tip_block.inverse().apply(np.column_stack([across, np.zeros((len(across), 2))]))
    inside = across[in_the_wall(points)]
    assert abs(inside.mean()) < 0.05e-3
    assert 1.2e-3 < np.ptp(inside) < 2.2e-3


@pytest.mark.parametrize("tilt_rad", [(0.06, 0.0), (0.0, -0.06), (-0.04, 0.05)])
def test_a_block_that_a_tilted_tool_grasped_where_it_stood_is_released_flat(tilt_rad):
    block = standing(2)
    tilted = grasped(block).T_board_tip @ SE3.from_parts(SO3.exp(np.array([*tilt_rad, 0.0])))
    T_tip_block = held_block(tilted, block, BLOCK)
    np.testing.assert_allclose(T_tip_block.matrix[:3, 2], (tilted.inverse() @ block).matrix[:3, 2], atol=1e-9)
    place = placed(8, T_tip_block)
    assert isinstance(place, SE3)
    lies = place @ T_tip_block
    np.testing.assert_allclose(lies.matrix[:3, 2], [0, 0, -1], atol=1e-9)
    assert lies.translation_m[2] == pytest.approx(BLOCK.height_m + DROP_M, abs=0.2e-3)
    assert np.linalg.norm(lies.translation_m[:2] - BOARD.pegs_m[8, :2]) == pytest.approx(FINGER_ROOM_M, abs=1e-5)
