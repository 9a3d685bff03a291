import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from trocar.arms import MotionLimits
from trocar.calibration.limited_paths import QuadraticSpline


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
