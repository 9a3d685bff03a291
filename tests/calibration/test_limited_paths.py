"""Quadratic splines, and those among them that keep limits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from trocar.arms import MOTION_LIMITS, MotionLimits
from trocar.calibration.limited_paths import LimitedPaths, QuadraticSpline


def random_spline(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    spline = QuadraticSpline(np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.1, n))]))
    return spline, rng.normal(size=(n + 2, 3)), rng


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_weights_tell_what_the_path_does(seed):
    spline, points, rng = random_spline(seed)
    path, knots, within = spline.trajectory(points), spline.intervals, spline.intervals[:-1]
    assert_allclose(spline.at(spline.position, knots, points), path(spline.times_s), atol=1e-9)
    before_the_end = spline.times_s.copy()
    before_the_end[-1] -= 1e-12
    assert_allclose(spline.at(spline.velocity, knots, points), path(before_the_end, 1), atol=1e-6)
    middles = (spline.times_s[:-1] + spline.times_s[1:]) / 2
    assert_allclose(spline.at(spline.acceleration, within, points), path(middles, 2), atol=1e-6)
    since = rng.uniform(0.0, 1.0, len(within)) * spline.steps_s
    assert_allclose(
        spline.at(spline.position_after(since), within, points), path(spline.times_s[:-1] + since), atol=1e-9
    )


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_path_is_smooth_at_its_knots_and_stays_between_its_control_points(seed):
    spline, points, _ = random_spline(seed)
    path = spline.trajectory(points)
    inner = spline.times_s[1:-1]
    for order in (0, 1):
        fastest = np.abs(path(spline.times_s, order + 1)).max()
        jump = np.abs(path(inner - 1e-9, order) - path(inner + 1e-9, order))
        assert jump.max(initial=0.0) <= 3e-9 * fastest + 1e-9
    q = path(np.linspace(0.0, spline.times_s[-1], 500))
    assert (q >= points.min(axis=0) - 1e-12).all() and (q <= points.max(axis=0) + 1e-12).all()
    assert_allclose(q[[0, -1]], points[[0, -1]], atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.2, 1e3]))
def test_the_reach_is_what_a_linear_programme_finds(seed, top):
    spline, _, rng = random_spline(seed)
    push = rng.uniform(0.5, 5.0)
    speed = rng.uniform(-1.0, 1.0) * min(top, push * spline.times_s[-1])
    limits = MotionLimits(np.array([top]), np.array([push]))
    h, times = spline.steps_s, spline.times_s
    lever = times[-1] - (times[:-1] + times[1:]) / 2
    running = np.tril(np.ones((len(h), len(h)))) * h
    best = linprog(
        -h * lever,
        A_ub=np.vstack([running, -running]),
        b_ub=np.concatenate([np.full(len(h), top - speed), np.full(len(h), top + speed)]),
        A_eq=h[None],
        b_eq=[-speed],
        bounds=[(-push, push)] * len(h),
    )
    assert best.status == 0  # some path of these intervals comes to rest
    found = spline.reach(np.array([speed]), limits)[0]
    exact = speed * times[-1] - best.fun
    if top > 1.0:
        assert found == pytest.approx(exact, abs=1e-9)
    assert exact - 1e-9 <= found <= exact + push * h.max() ** 2


@pytest.mark.parametrize(("speed", "way"), [(0.0, 2.5), (1.0, 2.75), (-1.0, 1.75), (0.5, 2.6875)])
def test_the_reach_at_full_speed_by_hand(speed, way):
    """Three seconds at 1 rad/s and 2 rad/s^2 at most: half a second up, half a second down, the rest at full speed."""
    limits = MotionLimits(np.array([1.0]), np.array([2.0]))
    for begin_s in (0.0, 7.0):
        spline = QuadraticSpline(begin_s + np.linspace(0.0, 3.0, 121))
        assert spline.reach(np.array([speed]), limits)[0] == pytest.approx(way, abs=1e-9)


def test_the_reach_of_joints_is_that_of_each():
    spline = QuadraticSpline(np.linspace(0.0, 0.5, 11))
    limits = MotionLimits(np.array([9.0, 0.5, 9.0]), np.array([2.0, 8.0, 1.0]))
    speed = np.array([0.1, -0.2, -0.3])
    alone = [MotionLimits(limits.velocity[[j]], limits.acceleration[[j]]) for j in range(3)]
    each = [spline.reach(speed[[j]], alone[j]) for j in range(3)]
    assert_allclose(spline.reach(speed, limits), np.ravel(each))


def test_a_path_of_its_own_clock_is_the_same_path():
    spline, points, _ = random_spline(5)
    later = QuadraticSpline(spline.times_s + 3.0)
    at = np.linspace(0.0, spline.times_s[-1], 50)
    assert_allclose(later.trajectory(points)(3.0 + at), spline.trajectory(points)(at), atol=1e-9)
    for name in ("position", "velocity", "acceleration"):
        assert_allclose(getattr(later, name), getattr(spline, name), rtol=1e-9, atol=1e-9)


TIMES = np.array([0.0, 0.05, 0.12, 0.2, 0.25, 0.36, 0.4, 0.5])
KNOTS, FREE = len(TIMES), len(TIMES) - 2
START, SPEED = np.array([0.1, 0.2, 0.05, -0.3, 0.4, 0.5]), np.array([0.01, -0.02, 0.005, 0.1, -0.05, 0.02])
WEIGHTS = np.linspace(0.5, 2.0, KNOTS)
WIDE = np.full(6, 10.0)


@pytest.fixture
def paths():
    limits = MotionLimits(np.full(6, 3.0), np.full(6, 40.0))
    return LimitedPaths(QuadraticSpline(TIMES), START, SPEED, limits, -WIDE, WIDE, WEIGHTS)


@pytest.fixture
def x():
    return START + np.random.default_rng(0).normal(0, 0.02, (FREE, 6))


def path_of(paths, x):
    return paths.spline.trajectory(paths.points(x))


def test_every_path_starts_as_it_is_told_to_and_ends_at_rest(paths, x):
    path = path_of(paths, x)
    assert_allclose(path(0.0), START, atol=1e-12)
    assert_allclose(path(0.0, 1), SPEED, atol=1e-12)
    assert_allclose(path(TIMES[-1] - 1e-12, 1), 0.0, atol=1e-9)
    assert_allclose(path(TIMES[-1]), x[-1], atol=1e-12)


def test_weights_of_all_control_points_are_those_of_the_free_ones(paths, x):
    """What hangs on the first two, which the start fixes, is left out; the last is that before it."""
    rng = np.random.default_rng(1)
    weights, intervals = rng.normal(size=(7, 3)), np.arange(7)
    data, columns = paths.columns(weights, intervals)
    whole = paths.spline.at(weights, intervals, paths.points(x))
    fixed = paths.spline.at(weights, intervals, paths.points(np.zeros_like(x)))
    assert_allclose(np.einsum("kw,kwj->kj", data, x[columns]), whole - fixed, atol=1e-12)
    assert columns.min() == 0 and columns.max() == FREE - 1


def cost(paths, x, wanted, nearness, smoothness):
    """Return half the weighted squares of errors at the knots and of accelerations, by the path itself."""
    path = path_of(paths, x)
    error = wanted - path(TIMES)
    push = path((TIMES[:-1] + TIMES[1:]) / 2, 2)
    squares = nearness * WEIGHTS[:, None] * error**2
    return 0.5 * (squares.sum() + np.sum(smoothness * np.diff(TIMES)[:, None] * push**2))


def test_hessian_and_gradient_are_those_of_the_cost(paths, x):
    rng = np.random.default_rng(2)
    nearness, smoothness = rng.uniform(1, 2, 6), rng.uniform(1, 2, 6) * 1e-4
    wanted = START + rng.normal(0, 0.1, (KNOTS, 6))
    hessian = paths.hessian(nearness, smoothness).toarray()
    assert hessian.shape == (6 * FREE, 6 * FREE)
    gradient = paths.pull(paths.resting - wanted) * nearness + paths.push * smoothness
    assert_allclose(paths.resting, path_of(paths, np.zeros_like(x))(TIMES), atol=1e-12)

    def at(x):
        flat = x.T.ravel()
        return 0.5 * flat @ hessian @ flat + gradient.T.ravel() @ flat

    zero = np.zeros_like(x)
    for _ in range(3):
        x = rng.normal(0, 0.1, (FREE, 6))
        expected = cost(paths, x, wanted, nearness, smoothness) - cost(paths, zero, wanted, nearness, smoothness)
        assert at(x) == pytest.approx(expected, rel=1e-9)


def test_what_limits_leave_free_is_the_least_of_a_quadratic_function(paths):
    wanted = START + 0.05 * np.sin(5 * TIMES)[:, None] * np.arange(1, 7)
    hessian = paths.hessian(np.ones(6), np.full(6, 1e-5))
    gradient = paths.pull(paths.resting - wanted) + paths.push * 1e-5
    x = paths.solve(hessian, gradient)
    assert_allclose(hessian @ x.T.ravel() + gradient.T.ravel(), 0.0, atol=1e-5)


def pulled(paths, wanted):
    """Return the path that comes nearest to positions at the knots."""
    hessian = paths.hessian(np.ones(6), np.full(6, 1e-9))
    return paths.solve(hessian, paths.pull(paths.resting - wanted) + paths.push * 1e-9)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("order", "most"), [(1, 0.7), (2, 4.0)])
def test_each_joint_runs_as_fast_or_is_pushed_as_hard_as_its_limit_allows_and_no_more(paths, joint, sign, order, most):
    speed, push = limits = np.full(6, 100.0), np.full(6, 40.0)
    limits[order - 1][joint] = most
    tight = replace(paths, limits=MotionLimits(speed, push))
    wanted = np.tile(START, (KNOTS, 1))
    wanted[:, joint] += sign * np.linspace(0.0, 5.0, KNOTS)
    path = path_of(tight, pulled(tight, wanted))
    at = TIMES[1:-1] if order == 1 else (TIMES[:-1] + TIMES[1:]) / 2
    reached = np.abs(path(at, order)).max(axis=0)
    assert most * (1 - 1e-4) < reached[joint] <= most
    assert order == 1 or (reached[np.arange(6) != joint] < 39.0).all()


def test_the_speed_at_the_start_counts_for_whether_a_joint_can_become_too_fast():
    """From .9 of its limit, a joint that could not reach it from rest can."""
    speed = np.array([0.9, 0, 0, 0, 0, 0])
    limits = MotionLimits(np.ones(6), np.array([2.5, *[1.9] * 5]))
    paths = LimitedPaths(QuadraticSpline(TIMES), START, speed, limits, -WIDE, WIDE, WEIGHTS)
    wanted = START + TIMES[:, None] * 5.0
    path = path_of(paths, pulled(paths, wanted))
    fastest = np.abs(path(TIMES, 1)).max(axis=0)
    assert 0.99 < fastest[0] <= 1.0
    assert (fastest[1:] < 0.5).all()


def test_a_joint_stays_in_its_range_where_it_would_leave_it(paths):
    lower, upper = -WIDE.copy(), WIDE.copy()
    lower[3], upper[5] = START[3] - 0.01, START[5] + 0.02
    boxed = replace(paths, lower=lower, upper=upper)
    wanted = START + 0.1 * np.sin(6 * TIMES)[:, None] * np.array([1, 1, 1, -1, 1, 1])
    free, kept = (path_of(one, pulled(one, wanted))(np.linspace(0, 0.5, 400)) for one in (paths, boxed))
    assert free[:, 3].min() < lower[3] - 0.01 and free[:, 5].max() > upper[5] + 0.01
    assert lower[3] <= kept[:, 3].min() < lower[3] + 2e-3
    assert upper[5] - 2e-3 < kept[:, 5].max() <= upper[5]
    assert_allclose(kept[:, [0, 1, 2, 4]], free[:, [0, 1, 2, 4]], atol=1e-6)


def test_where_nothing_is_allowed_there_is_nothing(paths):
    wanted = np.tile(START, (KNOTS, 1))
    too_fast = replace(paths, velocity_start=np.full(6, 2.0), limits=MotionLimits(np.full(6, 3.0), np.full(6, 3.0)))
    assert pulled(too_fast, wanted) is None
    assert pulled(paths, wanted) is not None
    elsewhere = replace(paths, lower=START - 9.0, upper=START - 5.0)
    assert pulled(elsewhere, wanted) is None


def test_a_path_of_two_intervals_has_one_free_point():
    limits = MOTION_LIMITS["paper"]
    spline = QuadraticSpline(np.array([0.0, 0.1, 0.2]))
    paths = LimitedPaths(spline, START, np.zeros(6), limits, -WIDE, WIDE, np.ones(3))
    x = pulled(paths, np.tile(START + 1e-3, (3, 1)))
    assert x.shape == (1, 6)
    path = path_of(paths, x)
    assert_allclose(path(0.0), START, atol=1e-12)
    assert_allclose(path(0.2 - 1e-12, 1), 0.0, atol=1e-8)
