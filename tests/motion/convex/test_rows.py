from dataclasses import replace

import numpy as np
import pytest

from ravens import CAMERA_M, NAMES, asked, down, joints, swapping
from trocar.arms import fk
from trocar.motion import Facing
from trocar.motion.convex.rows import Rows, distance_rows, facing_rows, range_rows, taper
from trocar.motion.convex.scene import Scene

PROBLEM = asked(swapping(0.03))
SCENE = Scene.of(PROBLEM)
START = np.concatenate([arm.waypoints[0] for arm in PROBLEM.arms.values()])


def test_rows_are_linear_in_what_the_control_points_move():
    rows = Rows(np.array([1.0, -2.0]), np.array([[1.0, 0.0], [2.0, 3.0]]), np.array([[0.5, 0.5], [0.0, 1.0]]))
    change = np.array([[2.0, 1.0], [4.0, -1.0]])  # each joint by its column
    np.testing.assert_allclose(rows.after(change), [1.0 + 3.0, -2.0 + 8.0 - 3.0])
    both = Rows.joined([rows, rows])
    np.testing.assert_allclose(both.after(change), np.tile(rows.after(change), 2))


def test_a_margin_grows_from_nothing_at_both_ends():
    shares = np.array([0.0, 0.05, 0.1, 0.5, 0.9, 0.95, 1.0])
    np.testing.assert_allclose(taper(shares, 2e-3), [0, 1e-3, 2e-3, 2e-3, 2e-3, 1e-3, 0], atol=1e-12)
    np.testing.assert_allclose(taper(shares, 1.0, share=0.2)[:3], [0, 0.25, 0.5], atol=1e-12)


def test_pairs_count_that_are_nearer_than_wanted_or_not_much_further():
    q = np.stack([START, START + [0.1, *np.zeros(11)]])
    distances = SCENE.distances(q, np.zeros(2))
    basis = np.array([[1.0, 0.0], [0.0, 1.0]])
    wanted_m = np.array([0.0, 0.01])
    watched_m = float(np.sort(distances.distance_m[0])[3]) + 1e-9
    rows = distance_rows(distances, wanted_m, basis, watched_m)
    nearest = [distances.distance_m[0] < watched_m, distances.distance_m[1] < watched_m + 0.01]
    assert nearest[0].sum() == 4 and nearest[1].sum() > 0
    assert len(rows.room) == nearest[0].sum() + nearest[1].sum()
    np.testing.assert_allclose(rows.room[:4], distances.distance_m[0, nearest[0]])
    np.testing.assert_allclose(rows.room[4:], distances.distance_m[1, nearest[1]] - 0.01)
    np.testing.assert_array_equal(rows.basis, np.repeat(basis, [4, len(rows.room) - 4], axis=0))


@pytest.mark.parametrize("joint", [2, 9])
def test_control_points_near_the_end_of_a_range_count_and_both_ends_do_not(joint):
    lower = np.concatenate([arm.model.lower for arm in SCENE.arms])
    upper = np.concatenate([arm.model.upper for arm in SCENE.arms])
    extent = upper - lower
    for slack in (0.0, 0.02):
        control = np.tile((lower + upper) / 2, (5, 1))
        control[[0, -1], joint] = upper[joint] + 1.0
        assert not len(range_rows(SCENE.arms, control, slack).room)
        for end, sign in ((lower, 1.0), (upper, -1.0)):
            for share, near in ((0.09, True), (0.11, False)):
                inside = 5e-4 - slack * extent[joint]
                control[2, joint] = end[joint] + sign * (inside + share * extent[joint])
                rows = range_rows(SCENE.arms, control, slack)
                assert len(rows.room) == near
                np.testing.assert_allclose(rows.room, near * [0.1 * share * extent[joint]])
                change = np.zeros_like(control)
                change[2, joint], change[1, joint - 1] = sign * 0.01, 5.0
                np.testing.assert_allclose(rows.after(change), rows.room + 0.1 * 0.01)


def facing_scene(max_rad):
    facing = Facing([0.0, 1.0, 0.0], CAMERA_M, max_rad)
    right = NAMES[1]
    return Scene.of(replace(PROBLEM, arms=PROBLEM.arms | {right: replace(PROBLEM.arms[right], facing=facing)})), right


def test_what_tips_face_has_room_by_the_cosines_and_slopes_by_its_joints_alone():
    scene, name = facing_scene(3.0)
    arm, q = PROBLEM.arms[name], np.tile(START, (2, 1))
    q[1, 6:] = joints(name, down([-0.055, 0.0, -0.12], 0.7))
    angles = scene.arms[1].facing.angle_rad(arm.T_world_base @ fk(arm.model, q[:, 6:]))
    assert abs(angles[0] - angles[1]) > 0.2
    basis = np.eye(2)
    for spare in (0.0, 0.05):
        limit = float(angles.max()) + 0.01
        distances = facing_scene(limit)[0].distances(q, np.zeros(2))
        rows = facing_rows(distances, np.full(2, spare), basis)
        wanted = 0.05 * (np.cos(angles) - np.cos(limit - spare))
        kept = wanted < 0.05 * 0.3
        assert 1 <= kept.sum() <= 2
        np.testing.assert_allclose(rows.room, wanted[kept], atol=1e-12)
        np.testing.assert_array_equal(rows.basis, basis[kept])
        assert not rows.slope[:, :6].any() and np.abs(rows.slope[:, 6:]).max() > 1e-3
    tight = facing_scene(1e-4)[0].distances(q, np.zeros(2))
    np.testing.assert_allclose(facing_rows(tight, np.ones(2), basis).room, 0.05 * (np.cos(angles) - np.cos(1e-3)))
    assert not len(facing_rows(SCENE.distances(q, np.zeros(2)), np.zeros(2), basis).room)  # nothing is asked
