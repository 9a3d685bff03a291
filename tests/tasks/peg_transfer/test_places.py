"""Where a held block is released."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import PSM_CLASSIC, fk
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.grasps import FINGER_ROOM_M, Grasp, Place, choose_grasp, choose_place, held_block
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

BOARD, BLOCK = Pegboard(), Block()
BASE = SE3.from_parts(SO3.axis("z", np.pi), [0.1332, 0.0, 0.166])
T_BASE_BOARD = BASE.inverse()
DROP_M = 2e-3
ROLL_RAD, MARGIN_RAD = np.radians(70.0), np.radians(5.0)


def standing(peg: int, offset_m=(0.0, 0.0), yaw: float = 0.0) -> SE3:
    place = BOARD.pegs_m[peg] + [*offset_m, BLOCK.height_m]
    return SE3.from_parts(SO3.axis("z", yaw) @ SO3(np.diag([1.0, -1.0, -1.0])), place)


def held(yaw: float = 0.4, peg: int = 1) -> SE3:
    """Return ``T_tip_block`` of a block grasped round its wall."""
    block = standing(peg, (0.6e-3, -0.4e-3), yaw)
    grasp = choose_grasp(PSM_CLASSIC, T_BASE_BOARD, block, BOARD, BLOCK)
    assert isinstance(grasp, Grasp)
    return held_block(grasp.T_board_tip, block, BLOCK)


def place_on(peg: int, T_tip_block: SE3, others=(), **kwargs) -> Place | str:
    return choose_place(PSM_CLASSIC, T_BASE_BOARD, T_tip_block, BOARD, BLOCK, peg, others, DROP_M, **kwargs)


@settings(max_examples=25, deadline=None)
@given(peg=st.integers(0, 11), yaw=st.floats(-np.pi, np.pi))
def test_the_block_ends_upright_over_its_peg_with_room_for_the_inner_finger(peg, yaw):
    T_tip_block = held(yaw)
    place = place_on(peg, T_tip_block)
    assert isinstance(place, Place), place
    T_board_block = place.T_board_tip @ T_tip_block
    off = T_board_block.translation_m[:2] - BOARD.pegs_m[peg, :2]
    to_tip = place.T_board_tip.translation_m[:2] - T_board_block.translation_m[:2]
    assert np.linalg.norm(off) == pytest.approx(FINGER_ROOM_M, abs=1e-6)
    assert off @ to_tip > 0.9 * np.linalg.norm(off) * np.linalg.norm(to_tip)
    assert T_board_block.translation_m[2] - BLOCK.height_m == pytest.approx(BOARD.pegs_m[peg, 2] + DROP_M, abs=1e-6)
    assert T_board_block.matrix[2, 2] == pytest.approx(-1.0, abs=1e-9)
    assert place.T_board_tip.matrix[2, 2] == pytest.approx(1.0, abs=1e-9)
    reached = fk(PSM_CLASSIC, place.q).matrix
    assert np.abs(reached - (T_BASE_BOARD @ place.T_board_tip).matrix).max() < 1e-9
    assert abs(place.q[3]) <= ROLL_RAD + 1e-12
    for joint, value in zip(PSM_CLASSIC.joints[4:], place.q[4:], strict=True):
        assert joint.lower + MARGIN_RAD <= value <= joint.upper - MARGIN_RAD


def test_the_open_finger_turns_away_from_a_neighbour():
    T_tip_block = held()
    alone = place_on(8, T_tip_block)
    assert isinstance(alone, Place)
    side = np.sign(T_tip_block.translation_m[0])
    outwards = alone.T_board_tip.rotation.apply([-side, 0.0, 0.0])[:2]
    middle = BOARD.pegs_m[8, :2] + 16.5e-3 * outwards
    neighbour = SE3.from_parts(SO3(np.diag([1.0, -1.0, -1.0])), [*middle, BLOCK.height_m])
    beside = place_on(8, T_tip_block, [neighbour])
    assert isinstance(beside, Place)
    turned = (alone.T_board_tip.rotation.inverse() @ beside.T_board_tip.rotation).log()
    assert np.linalg.norm(turned) > np.radians(5.0)
    assert beside.room_m > 0.0


def test_what_no_wrist_can_do_is_a_sentence():
    answer = place_on(0, held(), margin_rad=np.radians(79.0))
    assert isinstance(answer, str)
    assert "peg 0" in answer and "limits" in answer


def test_a_board_out_of_reach_is_a_sentence():
    far = SE3.from_parts(translation_m=[0.0, 0.0, -0.5]) @ T_BASE_BOARD
    answer = choose_place(PSM_CLASSIC, far, held(), BOARD, BLOCK, 3, [], DROP_M)
    assert isinstance(answer, str) and "peg 3" in answer


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_jaws_centre_the_wall_between_them(seed):
    rng = np.random.default_rng(seed)
    block = standing(2, rng.uniform(-1e-3, 1e-3, 2), rng.uniform(-np.pi, np.pi))
    grasp = choose_grasp(PSM_CLASSIC, T_BASE_BOARD, block, BOARD, BLOCK)
    if not isinstance(grasp, Grasp):
        return
    T_tip_block = held_block(grasp.T_board_tip, block, BLOCK)
    before = (grasp.T_board_tip.inverse() @ block).matrix
    after = T_tip_block.matrix
    assert np.allclose(after[[1, 2, 0, 1, 2], [3, 3, 0, 0, 0]], before[[1, 2, 0, 1, 2], [3, 3, 0, 0, 0]])
    assert abs(after[0, 3] - before[0, 3]) < 1.2e-3
    across = np.linspace(-2.0e-3, 2.0e-3, 401)
    inside = across[in_the_wall(T_tip_block, across)]
    assert abs(inside.mean()) < 0.05e-3
    assert 1.2e-3 < np.ptp(inside) < 2.2e-3


@pytest.mark.parametrize("tilt_rad", [(0.06, 0.0), (0.0, -0.06), (-0.04, 0.05)])
def test_a_block_that_a_tilted_tool_grasped_where_it_stood_is_released_flat(tilt_rad):
    block = standing(2)
    grasp = choose_grasp(PSM_CLASSIC, T_BASE_BOARD, block, BOARD, BLOCK)
    assert isinstance(grasp, Grasp)
    tilted = grasp.T_board_tip @ SE3.from_parts(SO3.exp(np.array([*tilt_rad, 0.0])))
    T_tip_block = held_block(tilted, block, BLOCK)
    np.testing.assert_allclose(T_tip_block.matrix[:3, 2], (tilted.inverse() @ block).matrix[:3, 2], atol=1e-9)
    place = choose_place(PSM_CLASSIC, T_BASE_BOARD, T_tip_block, BOARD, BLOCK, 8, [], 2e-3)
    assert isinstance(place, Place)
    placed = place.T_board_tip @ T_tip_block
    np.testing.assert_allclose(placed.matrix[:3, 2], [0, 0, -1], atol=1e-9)
    assert placed.translation_m[2] == pytest.approx(BLOCK.height_m + 2e-3, abs=0.2e-3)
    assert np.linalg.norm(placed.translation_m[:2] - BOARD.pegs_m[8, :2]) == pytest.approx(FINGER_ROOM_M, abs=1e-5)


def in_the_wall(T_tip_block: SE3, x_m):
    """Return which points (n,) on the line between the fingers lie inside the wall."""
    p = T_tip_block.inverse().apply(np.column_stack([x_m, np.zeros((len(x_m), 2))]))
    radius, angle = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])
    return (BLOCK.hole_radius_m(angle) < radius) & (radius < BLOCK.outer_radius_m(angle))
