"""The convex programme in the control points of a curve: rows, solution and certificate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ravens import CAMERA_M, NAMES, asked, down, joints, swapping
from trocar.arms import fk
from trocar.motion import Facing
from trocar.motion.convex import path_program as module
from trocar.motion.convex.path_program import (
    PathProgram,
    Rows,
    distance_rows,
    faces,
    facing_rows,
    in_range,
    range_rows,
    taper,
)
from trocar.motion.convex.scene import Scene
from trocar.motion.curve import Curve

PROBLEM = asked(swapping(0.03))
ARMS = tuple(PROBLEM.arms.values())
START = np.concatenate([arm.waypoints[0] for arm in ARMS])
UPPER = np.concatenate([arm.model.upper for arm in ARMS])
LOWER = np.concatenate([arm.model.lower for arm in ARMS])


@pytest.mark.parametrize("joint", [2, 11])
@pytest.mark.parametrize("slack", [0.0, 0.01])
def test_what_a_parabola_hides_between_two_places_counts(joint, slack):
    """Four places: the two in the middle are equally far, the peak between them an eighth of the bend further."""
    for end, sign in ((UPPER, 1.0), (LOWER, -1.0)):
        bound = end[joint] + sign * slack * (UPPER - LOWER)[joint]
        for room, inside in ((1e-6, True), (-1e-6, False)):
            q = np.tile((LOWER + UPPER) / 2, (4, 1))
            bend = 1e-3
            q[:, joint] = bound - sign * (room + bend / 8 + bend * np.array([1.0, 0.0, 0.0, 1.0]))
            assert in_range(ARMS, q, slack) == inside


def test_all_places_are_looked_at_for_ranges():
    q = np.tile((LOWER + UPPER) / 2, (5, 1))
    assert in_range(ARMS, q, 0.0)
    for row in range(5):
        for end, joint in ((UPPER, 0), (LOWER, 6)):
            beyond = q.copy()
            beyond[row, joint] = end[joint] + np.sign(end[joint] - q[row, joint]) * 0.1
            assert not in_range(ARMS, beyond, 0.0)


@pytest.mark.parametrize("inner", [[0.3, 0.35, 0.2], [0.35, 0.3, 0.2], [0.1, 0.2, 0.35]])
def test_what_a_tip_faces_is_judged_between_the_first_place_and_the_last(inner):
    left, right = ARMS
    turns = [0.0, *inner, 0.9]
    q = np.tile(START, (5, 1))
    q[:, 6:] = [joints("right", down([-0.055, 0.0, -0.12], turn)) for turn in turns]
    facing = Facing([0.0, 1.0, 0.0], [-0.05, 0.5, -0.12], 3.0)
    angles = facing.angle_rad(right.T_world_base @ fk(right.model, q[:, 6:]))
    hidden = np.abs(np.diff(angles, n=2)).max() / 8
    least = angles[1:-1].max() + hidden
    assert hidden > 0.01 and angles[-1] > least > angles[1:-1].max()
    for off, kept in ((1e-6, True), (-1e-6, False)):
        limited = replace(right, facing=replace(facing, max_rad=float(least + off)))
        assert faces((left, limited), q) == kept
    assert faces((left, right), q)  # nothing is asked


SCENE = Scene.of(PROBLEM)


def test_rows_are_linear_in_what_the_control_points_move():
    rows = Rows(np.array([1.0, -2.0]), np.array([[1.0, 0.0], [2.0, 3.0]]), np.array([[0.5, 0.5], [0.0, 1.0]]))
    change = np.array([[2.0, 1.0], [4.0, -1.0]])  # each joint by its column
    np.testing.assert_allclose(rows.after(change), [1.0 + 3.0, -2.0 + 8.0 - 3.0])
    both = Rows.joined([rows, rows])
    np.testing.assert_allclose(both.after(change), np.tile(rows.after(change), 2))


def test_a_margin_grows_from_nothing_at_both_ends():
    shares = np.array([0.0, 0.05, 0.1, 0.5, 0.9, 0.95, 1.0])
    np.testing.assert_allclose(taper(shares, 2e-3), [0, 1e-3, 2e-3, 2e-3, 2e-3, 1e-3, 0], atol=1e-12)


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
            for share, near in ((-0.2, True), (0.09, True), (0.11, False)):
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


CURVE = Curve.even(5)
JOINTS = 12


def program(held=()):
    weights = np.tile([1.0, 1.0, 100.0, 1.0, 1.0, 1.0], 2)
    none = np.zeros((0, CURVE.controls))
    return PathProgram(CURVE, weights, tuple(held) or (none, none))


def some_rows(rng, count=12):
    shares = rng.uniform(0.2, 0.8, count)
    return Rows(rng.uniform(-0.01, 0.02, count), 0.1 * rng.normal(size=(count, JOINTS)), CURVE.basis(shares))


def cost(asked, control, rows, change, price, damping):
    count = CURVE.controls
    near = damping / count * (asked.weights * change**2).sum() / 2
    return asked.energy(control + change) + near + price * np.maximum(0, -rows.after(change)).sum()


@pytest.mark.parametrize(("price", "damping"), [(1.0, 0.0), (100.0, 0.0), (100.0, 5.0), (1e4, 0.0)])
def test_a_step_is_the_least_of_what_it_costs(price, damping):
    """No change nearby, nor any of many random ones, costs less: the programme is convex."""
    rng = np.random.default_rng(0)
    asked = program()
    control = CURVE.line(np.zeros(JOINTS), rng.normal(size=JOINTS) * 0.3)
    control[1:-1] += 0.02 * rng.normal(size=(CURVE.controls - 2, JOINTS))
    rows = some_rows(rng)
    change = asked.step(control, rows, price, damping)
    least = cost(asked, control, rows, change, price, damping)
    assert least < cost(asked, control, rows, 0 * change, price, damping)
    for size in (1e-4, 1e-3, 1e-2, 0.1):
        for _ in range(200):
            aside = size * rng.normal(size=change.shape)
            aside[[0, -1]] = 0.0
            assert cost(asked, control, rows, change + aside, price, damping) >= least * (1 - 1e-6)


def test_what_is_free_is_weighed_by_its_energy_and_the_damping():
    """Against the equations of the least: energy and damping on inner control points, waypoints held by multipliers."""
    held = CURVE.basis(np.array([0.3, 0.6]))
    asked = program([held, np.zeros((0, CURVE.controls))])
    rng = np.random.default_rng(4)
    control = rng.normal(size=(CURVE.controls, JOINTS))
    nothing = Rows(np.zeros(0), np.zeros((0, JOINTS)), np.zeros((0, CURVE.controls)))
    for damping in (0.0, 3.0):
        change = asked.step(control, nothing, 1.0, damping)
        for k, rows in enumerate((held, held[:0])):
            fixed = np.vstack([rows, np.eye(CURVE.controls)[[0, -1]]])
            matrix = CURVE.energy + damping * np.eye(CURVE.controls) / CURVE.controls
            zero = np.zeros((len(fixed), len(fixed)))
            whole = np.block([[matrix, fixed.T], [fixed, zero]])
            right = np.vstack([-CURVE.energy @ control, np.zeros((len(fixed), JOINTS))])
            wanted = np.linalg.solve(whole, right)[: CURVE.controls]
            columns = slice(6 * k, 6 * k + 6)
            np.testing.assert_allclose(change[:, columns], wanted[:, columns], atol=1e-8)
        assert asked.inverses(damping) is asked.inverses(damping)


def test_energy_is_half_the_weighed_squares_and_rows_that_are_kept_change_nothing():
    asked = program()
    control = np.zeros((CURVE.controls, JOINTS))
    control[:, 2] = CURVE.places
    assert asked.energy(control) == pytest.approx(100.0 / 2)  # unit speed of a joint that weighs 100
    control[:, 0] = 2 * CURVE.places
    assert asked.energy(control) == pytest.approx(50.0 + 4 / 2)
    rows = some_rows(np.random.default_rng(5))
    far = Rows(rows.room + 10.0, rows.slope, rows.basis)
    nothing = Rows(np.zeros(0), np.zeros((0, JOINTS)), np.zeros((0, CURVE.controls)))
    np.testing.assert_array_equal(asked.step(control, far, 9.0, 0.0), asked.step(control, nothing, 9.0, 0.0))


def test_more_broken_rows_than_are_added_at_a_time_are_all_kept():
    rng = np.random.default_rng(6)
    control = CURVE.line(np.zeros(JOINTS), np.full(JOINTS, 0.2))
    basis = CURVE.basis(np.full(100, 0.5))
    slope = np.zeros((100, JOINTS))
    slope[:, 0] = 0.1
    rows = Rows(-rng.uniform(0.001, 0.01, 100), slope, basis)  # the same joint at the same place, by so much
    change = program().step(control, rows, 1e6, 0.0)
    assert rows.after(change).min() == pytest.approx(0.0, abs=1e-5)
    assert rows.after(change).max() < 0.01


def test_prices_are_between_nothing_and_the_greatest():
    """x gram x / 2 - missing x with a diagonal: missing / gram, cut off at 0 and at the price."""
    found = module._bounded_least(np.diag([2.0, 4.0, 0.5, 0.1]), np.array([1.0, -3.0, 8.0, 0.1]), 5.0)
    np.testing.assert_allclose(found, [0.5, 0.0, 5.0, 1.0], atol=1e-5)
    gram = np.array([[2.0, 1.0], [1.0, 3.0]])
    np.testing.assert_allclose(module._bounded_least(gram, gram @ [0.5, 0.7], 9.0), [0.5, 0.7], atol=1e-6)
