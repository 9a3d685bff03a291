import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from ravens import asked, random_waypoints
from trocar.arms import ARMS, MotionLimits
from trocar.motion import ArmMotion, limit_use
from trocar.motion.check import tip_speeds_m_s
from trocar.motion.convex import retime
from trocar.motion.convex.retime import retimed
from trocar.motion.convex.scene import joint_path
from trocar.motion.curve import Curve
from trocar.trajectory import Trajectory


def wild_path(rng, problem, pieces=9):
    curve = Curve.even(pieces)
    ends = [np.concatenate([arm.waypoints[i] for arm in problem.arms.values()]) for i in (0, -1)]
    control = curve.line(*ends)
    control[1:-1] += 0.1 * rng.normal(size=control[1:-1].shape) * np.tile([1, 1, 0.1, 1, 1, 1], 2)
    return curve.path(control)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), limit=st.sampled_from([0.01, 0.1, np.inf]))
def test_any_path_is_followed_exactly_and_within_all_limits(seed, limit):
    rng = np.random.default_rng(seed)
    problem = asked(random_waypoints(rng), max_tip_m_s=limit)
    path, arms = wild_path(rng, problem), tuple(problem.arms.values())
    timing = retimed(path, arms, np.array([0.0, 0.37, 1.0]))
    motion = timing.motion
    np.testing.assert_allclose(motion(motion.times_s), path(timing.shares), atol=1e-9)
    np.testing.assert_allclose(motion(timing.times_s(np.array([0.37]))), path(np.array([0.37])), atol=1e-9)
    # between the knots too it is on the path: by the share that it has reached
    times = np.linspace(0, motion.duration_s, 500)
    dense = path(np.linspace(0, 1, 4001))
    off = np.abs(motion(times[::25])[:, None] - dense[None]).max(axis=2).min(axis=1)
    assert off.max() < 1e-3
    for k, arm in enumerate(arms):
        use = limit_use(arm.model, joint_path(motion, k), arm.limits)
        assert max(use.velocity_ratio, use.acceleration_ratio) <= 1 + 1e-9
    np.testing.assert_allclose(motion(np.array([0.0, np.nextafter(motion.duration_s, 0)]), 1), 0, atol=1e-7)


def test_a_later_start_waits_first_and_passes_all_places_later():
    rng = np.random.default_rng(2)
    problem = asked(random_waypoints(rng))
    timing = retimed(wild_path(rng, problem), tuple(problem.arms.values()), np.array([0.5]))
    later = timing.later(0.7)
    np.testing.assert_array_equal(later.motion(np.array([0.0, 0.3])), np.repeat(timing.motion(0.0)[None], 2, axis=0))
    np.testing.assert_allclose(later.motion(1.2), timing.motion(0.5))
    shares = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(later.times_s(shares), timing.times_s(shares) + [0.0, 0.7, 0.7])
    assert timing.later(0.0) is timing


MODEL = ARMS["raven2-left"]


def one_arm(velocity=1e3, acceleration=2.0, max_tip_m_s=np.inf):
    limits = MotionLimits(np.full(6, velocity), np.full(6, acceleration))
    points = MODEL.middle + np.outer([0, 1], [0.3, 0.2, 0.02, 0.5, -0.2, 0.1])
    return ArmMotion(MODEL, points, limits, max_tip_m_s=max_tip_m_s)


def straight_path(*arms):
    start, end = (np.concatenate([arm.waypoints[i] for arm in arms]) for i in (0, -1))
    return Trajectory(np.array([0.0, 1.0]), np.stack([end - start, start])[:, None])


def bent_path(seed, pieces=4, size=0.01):
    arm, curve, rng = one_arm(), Curve.even(pieces), np.random.default_rng(seed)
    control = curve.line(*arm.waypoints)
    control[1:-1] += size * rng.normal(size=control[1:-1].shape)
    return curve.path(control)


def squares_by_programme(path, shares, velocity, acceleration):
    """The greatest squares of ds/dt at the shares, from rest to rest, as one linear programme of them all.

    In a step the push is half the square's change over the share; acceleration is ``slope push + bend square``.
    """
    n, h = len(shares), np.diff(shares)
    inner = np.minimum(shares, np.nextafter(1.0, 0.0))
    slope, bend = path(inner, 1), path(inner, 2)
    rows = []
    for i in range(n - 1):
        for j in (i, i + 1):
            block = np.zeros((6, n))
            block[:, i + 1], block[:, i] = slope[j] / (2 * h[i]), -slope[j] / (2 * h[i])
            block[:, j] += bend[j]
            rows += [block, -block]
    caps = ((velocity / np.abs(slope).max(axis=1)) ** 2).tolist()
    bounds = [(0, 0), *((0, cap) for cap in caps[1:-1]), (0, 0)]
    rows = np.concatenate(rows)
    return linprog(-np.ones(n), A_ub=rows, b_ub=np.full(len(rows), acceleration), bounds=bounds).x


@pytest.mark.parametrize(("seed", "velocity"), [(0, 1e3), (1, 1e3), (2, 0.5)])
def test_the_speeds_are_the_greatest_that_the_limits_leave(seed, velocity):
    path, shares = bent_path(seed), np.linspace(0, 1, 26)
    less = 1 - retime.HEADROOM
    best = squares_by_programme(path, shares, less * velocity, less * 2.0)
    found = retime._fastest(path, shares, (one_arm(velocity),))
    np.testing.assert_allclose(found, best, rtol=1e-6, atol=1e-9)


def test_both_arms_are_timed_by_the_slower_one():
    quick, slow = one_arm(), one_arm(acceleration=0.5)
    for arms in ((quick, slow), (slow, quick)):
        motion = retimed(straight_path(*arms), arms, np.zeros(0)).motion
        assert motion.duration_s == pytest.approx(2 * np.sqrt(0.5 / 0.5), rel=5e-3)
    both = retimed(straight_path(quick, quick), (quick, quick), np.zeros(0)).motion
    assert both.duration_s == pytest.approx(2 * np.sqrt(0.5 / 2.0), rel=5e-3)


@pytest.mark.parametrize(("velocity", "seconds"), [(1e3, 1.0), (0.25, 2.125), (0.5, 1.25)])
def test_one_straight_line_takes_the_time_of_its_trapezoid(velocity, seconds):
    """Half a radian at 2 rad/s^2: 2 sqrt(d / a), or d / v + v / a."""
    arm = one_arm(velocity)
    timing = retimed(straight_path(arm), (arm,), np.zeros(0))
    assert seconds * (1 - 1e-9) <= timing.motion.duration_s < 1.02 * seconds
    use = limit_use(MODEL, timing.motion, arm.limits)
    assert use.kept and max(use.velocity_ratio, use.acceleration_ratio) > 1 - 1e-6
    assert len(timing.shares) == 26  # 25 steps at least
    np.testing.assert_allclose(timing.shares, np.linspace(0, 1, 26))


def test_a_curve_is_cut_into_five_steps_a_piece_and_at_what_is_passed():
    arm = one_arm()
    for pieces, steps in ((4, 7), (5, 5), (9, 5)):
        shares = retimed(bent_path(0, pieces), (arm,), np.array([0.0, 0.331, 1.0 - 1e-12])).shares
        even = np.linspace(0, 1, pieces * steps + 1)
        np.testing.assert_allclose(shares, np.sort(np.append(even, 0.331)), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_a_tip_that_may_be_only_so_fast_is_nearly_that_fast_all_the_way(seed):
    arm = one_arm(max_tip_m_s=0.01)
    motion = retimed(bent_path(seed), (arm,), np.zeros(0)).motion
    times = np.linspace(0, motion.duration_s, 2000)[1:-1]
    speeds = tip_speeds_m_s(arm, motion(times), motion(times, 1))
    assert 0.0097 < speeds.max() <= 0.01 * (1 + 1e-6)
    assert np.mean(speeds > 0.009) > 0.7
    other = one_arm(max_tip_m_s=0.02)
    faster = retimed(bent_path(seed), (other,), np.zeros(0)).motion
    assert faster.duration_s == pytest.approx(motion.duration_s / 2, rel=1e-6)


@pytest.mark.parametrize("k", [0, 1])
def test_one_slow_tip_slows_down_both_arms(k):
    free, slow = one_arm(), one_arm(max_tip_m_s=0.01)
    arms = (slow, free) if k == 0 else (free, slow)
    motion = retimed(straight_path(*arms), arms, np.zeros(0)).motion
    alone = retimed(straight_path(slow), (slow,), np.zeros(0)).motion
    assert motion.duration_s == pytest.approx(alone.duration_s, rel=1e-6)
    assert motion.duration_s > 2 * retimed(straight_path(free), (free,), np.zeros(0)).motion.duration_s


@pytest.mark.parametrize("path", [bent_path(3), straight_path(one_arm())], ids=["bent", "straight"])
def test_a_path_over_time_is_the_path_at_the_share_that_is_reached(path):
    """In every step the share is a quadratic of time, from one speed to the next."""
    rng = np.random.default_rng(0)
    shares = np.unique(np.concatenate([rng.uniform(0, 1, 9), path.times_s]))
    speeds = rng.uniform(0.2, 1.0, len(shares))
    motion = retime._composed(path, shares, speeds)
    seconds = np.diff(shares) / ((speeds[1:] + speeds[:-1]) / 2)
    np.testing.assert_allclose(np.diff(motion.times_s), seconds)
    for part in (0.0, 0.3, 0.9):
        t = part * seconds
        share = shares[:-1] + speeds[:-1] * t + (speeds[1:] - speeds[:-1]) / seconds * t**2 / 2
        rate = speeds[:-1] + (speeds[1:] - speeds[:-1]) / seconds * t
        when = motion.times_s[:-1] + t
        np.testing.assert_allclose(motion(when), path(share), atol=1e-11)
        np.testing.assert_allclose(motion(when, 1), path(share, 1) * rate[:, None], atol=1e-9)


def test_pairs_of_accelerations_bound_the_speed_where_joints_bend():
    lean, width = np.array([[2.0, -1.0, 0.0], [0.5, 0.5, 0.5]]), np.array([[3.0, 1.5, np.inf], [1.0, 2.0, 3.0]])
    found = retime._widest(lean, width)
    assert found[0] == pytest.approx(4.5 / 3) and found[1] == np.inf
    assert np.all(retime._widest(np.zeros((2, 3)), width) == np.inf)


def test_a_joint_that_bends_where_it_does_not_move_bounds_the_speed():
    """Turning round half way: the slope is 0 there, and the bend alone accelerates."""
    arm = one_arm()
    coefficients = np.zeros((4, 1, 6))
    coefficients[1:3, 0, 0] = -2.0, 2.0  # 2 s - 2 s^2, bend -4
    turning = Trajectory(np.array([0.0, 1.0]), coefficients)
    shares = np.linspace(0, 1, 3)
    less = (1 - retime.HEADROOM) * 2.0
    assert retime._fastest(turning, shares, (arm,))[1] == pytest.approx(less / 4)
