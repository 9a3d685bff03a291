from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import PSM_CLASSIC, fk, frames
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.grasps import Grasp, Jaws, choose_grasp, grasp_candidates
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

BASE = SE3.from_parts(translation_m=[0.0, 0.0, -0.17])
"""T_base_board: remote centre 170 mm above the board's middle."""


def standing(peg: int, offset_m=(0.0, 0.0), yaw: float = 0.0) -> SE3:
    place = Pegboard().pegs_m[peg] + [*offset_m, Block().height_m]
    return SE3.from_parts(SO3.axis("z", yaw) @ SO3(np.diag([1.0, -1.0, -1.0])), place)


def test_candidates_lie_in_the_walls_and_point_down_the_block():
    grasps = grasp_candidates()
    radius = np.linalg.norm(grasps.translation_m[:, :2], axis=-1)
    angle = np.arctan2(grasps.translation_m[:, 1], grasps.translation_m[:, 0])
    assert (radius > Block().hole_radius_m(angle)).all() and (radius < Block().outer_radius_m(angle)).all()
    assert np.allclose(grasps.matrix[:, :3, 2], [0, 0, -1])
    assert np.allclose(np.linalg.det(grasps.matrix[:, :3, :3]), 1)


def test_jaws_open_along_the_tips_x():
    q = np.array([0.1, -0.2, 0.12, 0.4, 0.2, -0.3])
    axis = frames(PSM_CLASSIC, q).matrix[6, :3, 2]  # of joint 6, that the jaws turn about
    assert np.allclose(np.abs(fk(PSM_CLASSIC, q).matrix[:3, :3].T @ axis), [0, 1, 0])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_choice_keeps_every_promise(seed):
    rng = np.random.default_rng(seed)
    peg = int(rng.integers(12))
    T = standing(peg, rng.uniform(-1e-3, 1e-3, 2), rng.uniform(0, 2 * np.pi))
    grasp = choose_grasp(PSM_CLASSIC, BASE, T, Pegboard(), Block())
    assert isinstance(grasp, Grasp)
    assert np.abs(fk(PSM_CLASSIC, grasp.q).matrix - (BASE @ grasp.T_board_tip).matrix).max() < 1e-9
    assert np.allclose(grasp.T_board_tip.matrix[:3, 2], [0, 0, 1])
    assert abs(grasp.q[3]) <= np.radians(70)
    thickness_m = Jaws.of(PSM_CLASSIC.instrument).thickness_m
    face = PSM_CLASSIC.tip_length_m * np.sin(grasp.jaw_rad / 2)
    for side in (-1, 1):  # the finger's middle is free of peg and wall by half its thickness and the clearance
        middle = grasp.T_board_tip.apply([side * (face + thickness_m / 2), 0, 0])
        peg_gap = np.linalg.norm(middle[:2] - Pegboard().pegs_m[peg][:2]) - Pegboard().peg_radius_m
        assert peg_gap >= grasp.clearance_m + thickness_m / 2 - 1e-9
        local = T.inverse().apply(middle)
        radius, angle = np.hypot(*local[:2]), np.arctan2(local[1], local[0])
        assert radius < Block().hole_radius_m(angle) or radius > Block().outer_radius_m(angle)


def test_takes_the_wall_farthest_from_the_peg():
    for yaw in np.radians([0, 40, 80, 200]):
        side = np.array([-np.sin(yaw), np.cos(yaw)])
        T = standing(3, -1.5e-3 * side, yaw)  # pushed away from `side`: the far wall is opposite to it
        grasp = choose_grasp(PSM_CLASSIC, BASE, T, Pegboard(), Block(), max_roll_rad=np.pi)
        assert isinstance(grasp, Grasp)
        distances = np.linalg.norm((T @ grasp_candidates()).translation_m - Pegboard().pegs_m[3], axis=-1)
        chosen = np.linalg.norm(grasp.T_board_tip.translation_m - Pegboard().pegs_m[3])
        assert chosen > np.sort(distances)[-3]


def test_a_neighbour_that_touches_the_wall_blocks_it():
    T = standing(1)
    alone = choose_grasp(PSM_CLASSIC, BASE, T, Pegboard(), Block())
    assert isinstance(alone, Grasp)
    outward = alone.T_board_tip.matrix[:3, 0] * np.sign(
        alone.T_board_tip.matrix[:3, 0] @ (alone.T_board_tip.translation_m - T.translation_m)
    )
    beside = SE3.from_parts(T.rotation, T.translation_m + 13e-3 * outward)
    moved = choose_grasp(PSM_CLASSIC, BASE, T, Pegboard(), Block(), SE3(beside.matrix[None]))
    assert isinstance(moved, str) or moved.candidate // 2 != alone.candidate // 2


def test_says_why_there_is_none():
    far = SE3.from_parts(translation_m=[1.0, 0.0, -0.1])
    answer = choose_grasp(PSM_CLASSIC, far, standing(0), Pegboard(), Block())
    assert isinstance(answer, str) and "out of reach" in answer
    with pytest.raises(TrocarError, match="one finite pose"):
        choose_grasp(PSM_CLASSIC, BASE, SE3.identity((2,)), Pegboard(), Block())


def test_a_thicker_instrument_has_less_room():
    gaps = []
    for finger_tip_m in (1.0e-3, 1.4e-3):
        instrument = replace(PSM_CLASSIC.instrument, finger_tip_m=finger_tip_m)
        found = choose_grasp(replace(PSM_CLASSIC, instrument=instrument), BASE, standing(1), Pegboard(), Block())
        assert isinstance(found, Grasp)
        gaps.append(found.clearance_m)
    assert 0.1e-3 < gaps[0] - gaps[1] < 0.4e-3  # of one finger at most what both could take away
