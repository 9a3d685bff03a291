"""The curve in joint space and the scene that it keeps clear of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ravens import asked, random_waypoints
from trocar.arms import capsules
from trocar.geometry.capsules import nearest_m, segment_distances_m
from trocar.motion import Capsule, HalfSpace, MovingArm
from trocar.motion.convex.path_program import facing_rows
from trocar.motion.convex.scene import Scene, joint_path
from trocar.motion.curve import Curve
from trocar.trajectory import Trajectory

CURVE = Curve.even(5)
CONTROL = np.random.default_rng(0).normal(size=(8, 2))


def test_it_starts_and_ends_at_its_outer_control_points():
    assert CURVE.controls == 8
    np.testing.assert_allclose(CURVE.basis(np.array([0.0, 1.0])) @ CONTROL, CONTROL[[0, -1]])
    np.testing.assert_allclose(CURVE.knots, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert CURVE.places[0] == 0.0 and CURVE.places[-1] == 1.0


@pytest.mark.parametrize("order", range(4))
def test_its_pieces_are_those_of_the_basis(order):
    shares = np.linspace(0.0, 1.0, 42)[:-1]
    path = CURVE.path(CONTROL)
    assert path.coefficients.shape == (4, 5, 2)
    np.testing.assert_allclose(path(shares, order), CURVE.basis(shares, order) @ CONTROL, atol=1e-9 * 10**order)


def test_its_energy_is_the_integral_of_speed_and_bending():
    """Squared first derivative and a hundredth of the squared second one, summed over 20,000 midpoints."""
    middles = (np.arange(20000) + 0.5) / 20000
    first, second = (CURVE.path(CONTROL)(middles, order) for order in (1, 2))
    wanted = (first**2 + 0.01 * second**2).mean(axis=0)
    np.testing.assert_allclose(np.einsum("cj,cd,dj->j", CONTROL, CURVE.energy, CONTROL), wanted, rtol=1e-5)


def test_places_inside_are_even_and_leave_out_both_ends():
    np.testing.assert_allclose(CURVE.inner(2), np.arange(1, 10) / 10)
    np.testing.assert_allclose(Curve.even(2).inner(3), np.arange(1, 6) / 6)


def test_a_line_of_control_points_goes_from_one_place_to_the_other():
    line = CURVE.line(np.array([1.0, 2.0]), np.array([3.0, -4.0]))
    np.testing.assert_allclose(CURVE.path(line)(np.array([0.0, 0.25, 1.0])), [[1, 2], [1.5, 0.5], [3, -4]], atol=1e-12)


OBSTACLES = {
    "table": HalfSpace([0.0, 0.0, -0.162], [0.0, 0.0, 1.0]),
    "rod": Capsule([-0.1, 0.02, -0.13], [-0.05, 0.0, -0.12], radius_m=2e-3),
    "ball": Capsule([-0.06, 0.0, -0.15], radius_m=3e-3),
}
HALF = 1e-5


def scene_at(seed, **more):
    """A scene of both arms, and joints (1, 12) in it."""
    rng = np.random.default_rng(seed)
    problem = asked(random_waypoints(rng), rng.uniform(0, 1.2, 2), obstacles=OBSTACLES, **more)
    q = np.concatenate([arm.waypoints[0] for arm in problem.arms.values()])[None]
    return Scene.of(problem), q + 0.05 * rng.normal(size=q.shape)


def quotients(function, q):
    """Central differences of a function (rows,) of joints (1, 12): (rows, 12)."""
    steps = HALF * np.eye(q.shape[1])
    return np.stack([(function(q + step) - function(q - step)) / (2 * HALF) for step in steps], axis=-1)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_gradients_of_all_distances_are_those_of_finite_differences(seed):
    scene, q = scene_at(seed)
    distances = scene.distances(q, np.zeros(1))
    pair = np.arange(len(scene.pairs))
    slopes = distances.gradients(0 * pair, pair)
    differences = quotients(lambda at: scene.distances(at, np.zeros(1)).distance_m[0], q)
    # where the nearest points leave the ends of both capsules the distance has a bend; it is smooth on both sides
    one_sided = np.abs(quotients(lambda at: scene.distances(at + 3 * HALF, np.zeros(1)).distance_m[0], q) - differences)
    smooth = one_sided.max(axis=1) < 3e-3
    assert smooth.mean() > 0.8
    np.testing.assert_allclose(slopes[smooth], differences[smooth], atol=2e-3)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rows_of_what_tips_face_are_linear_about_the_joints(seed):
    scene, q = scene_at(seed, max_rad=1.5)
    basis = np.ones((1, 1))

    def rows(at):
        return facing_rows(scene.distances(at, np.zeros(1)), np.zeros(1), basis)

    found = rows(q)
    if not len(found.room):
        return
    np.testing.assert_allclose(found.slope, quotients(lambda at: rows(at).room, q), atol=1e-6)


def test_axes_that_cross_are_pushed_apart_along_their_common_normal():
    scene, q = scene_at(3)
    shafts = np.flatnonzero((scene.pairs == [0, 4]).all(axis=1))
    a, b = scene.ends_m(q, np.zeros(1))[0, [0, 4]]
    assert np.linalg.norm(np.cross(a[1] - a[0], b[1] - b[0])) > 0
    distances = scene.distances(q, np.zeros(1))
    distances.gaps_m[0, shafts] = 0.0  # as where they meet exactly
    slopes = distances.gradients(np.zeros(1, dtype=int), shafts)
    assert np.isfinite(slopes).all() and np.abs(slopes).max() > 1e-3
    normal = np.cross(a[1] - a[0], b[1] - b[0])
    distances.gaps_m[0, shafts] = 3e-9 * normal / np.linalg.norm(normal)  # as where they just do not touch
    np.testing.assert_allclose(distances.gradients(np.zeros(1, dtype=int), shafts), slopes, atol=1e-7)


def test_the_shares_of_the_nearest_points_lead_to_the_shortest_vector():
    rng = np.random.default_rng(1)
    p0, p1, q0, q1 = rng.normal(size=(4, 500, 3))
    gap, s, t = nearest_m(p0, p1, q0, q1)
    np.testing.assert_allclose(p0 + s[:, None] * (p1 - p0) - q0 - t[:, None] * (q1 - q0), gap, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(gap, axis=1), segment_distances_m(p0, p1, q0, q1))


def test_distances_are_those_of_segments_less_both_radii():
    scene, q = scene_at(11)
    q = np.concatenate([q, q + 0.01])
    found = scene.distances(q, np.zeros(2))
    for k, arm in enumerate(scene.arms):
        for row in range(2):
            solids = capsules(arm.model, q[row, 6 * k : 6 * k + 6], arm.jaw_rad).moved(arm.T_world_base)
            np.testing.assert_allclose(found.ends_m[row, 4 * k : 4 * k + 4], solids.ends_m)
    for column, (a, b) in enumerate(scene.pairs):
        p, r = found.ends_m[:, a], found.ends_m[:, b]
        apart = segment_distances_m(p[:, 0], p[:, 1], r[:, 0], r[:, 1])
        wanted = apart - scene.bodies.radii_m[a] - scene.bodies.radii_m[b]
        np.testing.assert_allclose(found.distance_m[:, column], wanted, atol=1e-7)
    assert len(scene.pairs) == 16 + 2 * 4 * 3
    few = scene.looking_at(found.distance_m[0] < 0.05)
    assert 0 < len(few.pairs) < len(scene.pairs) and len(few.everything().pairs) == len(scene.pairs)


@pytest.mark.parametrize(
    ("coefficients", "start_s", "timed"), [(1, 0.0, False), (2, 0.0, True), (2, -0.9, True), (2, -1.1, False)]
)
def test_when_a_place_is_passed_matters_where_another_arm_still_moves(coefficients, start_s, timed):
    problem = asked(random_waypoints(np.random.default_rng(0)), obstacles=OBSTACLES)
    right = problem.arms["right"]
    terms = np.stack([0.01 * np.ones(6), right.waypoints[0]])[-coefficients:]
    other = MovingArm(right.model, Trajectory(np.array([0.0, 1.0]), terms[:, None]), right.T_world_base, start_s)
    beside = replace(problem, arms={"left": problem.arms["left"]}, others={"right": other})
    scene = Scene.of(beside)
    assert scene.timed == timed
    assert not Scene.of(problem).timed
    q = problem.arms["left"].waypoints[[0, 0]]
    times = np.array([0.0, 0.5])
    np.testing.assert_allclose(scene.ends_m(q, times)[:, 4:8], other.ends_m(times))


def test_joints_of_one_arm_are_cut_out_of_all():
    path = Trajectory(np.array([0.0, 1.0]), np.arange(24.0).reshape(2, 1, 12))
    np.testing.assert_array_equal(joint_path(path, 1).coefficients, path.coefficients[:, :, 6:])
    np.testing.assert_array_equal(joint_path(path, 0).coefficients, path.coefficients[:, :, :6])
