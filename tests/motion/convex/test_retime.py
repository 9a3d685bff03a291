import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ravens import asked, random_waypoints
from trocar.motion import limit_use, rest_to_rest
from trocar.motion.convex.curve import curve_of
from trocar.motion.convex.retime import retimed
from trocar.motion.convex.scene import joint_path
from trocar.trajectory import Trajectory


def wild_path(rng, problem, pieces=9):
    curve = curve_of(pieces)
    ends = [np.concatenate([arm.waypoints[i] for arm in problem.arms.values()]) for i in (0, -1)]
    control = curve.line(*ends)
    control[1:-1] += 0.1 * rng.normal(size=control[1:-1].shape) * np.tile([1, 1, 0.1, 1, 1, 1], 2)
    return curve.path(control)


@settings(max_examples=20, deadline=None)
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
    dense = path(np.linspace(0, 1, 20001))
    off = np.abs(motion(times[::25])[:, None] - dense[None]).max(axis=2).min(axis=1)
    assert off.max() < 1e-3
    for k, arm in enumerate(arms):
        use = limit_use(arm.model, joint_path(motion, k), arm.limits)
        assert max(use.velocity_ratio, use.acceleration_ratio) <= 1 + 1e-9
    np.testing.assert_allclose(motion(np.array([0.0, np.nextafter(motion.duration_s, 0)]), 1), 0, atol=1e-7)


def test_a_straight_line_takes_hardly_longer_than_the_shortest_motion():
    problem = asked(random_waypoints(np.random.default_rng(4)))
    arms = tuple(problem.arms.values())
    start, end = (np.concatenate([arm.waypoints[i] for arm in arms]) for i in (0, -1))
    timing = retimed(Trajectory(np.array([0.0, 1.0]), np.stack([end - start, start])[:, None]), arms, np.zeros(0))
    shortest_s = max(rest_to_rest(*arm.waypoints, arm.limits).duration_s for arm in arms)
    assert len(timing.motion.coefficients) == 3
    assert shortest_s * (1 - 1e-9) <= timing.motion.duration_s < 1.02 * shortest_s


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


@pytest.mark.parametrize("pieces", [1, 5, 9])
def test_control_points_in_line_make_the_straight_line(pieces):
    curve = curve_of(pieces)
    path = curve.path(curve.line(np.zeros(3), np.array([1.0, -2.0, 3.0])))
    shares = np.linspace(0, 1, 33)
    np.testing.assert_allclose(path(shares), shares[:, None] * [1.0, -2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(curve.basis(shares) @ curve.places, shares, atol=1e-12)
    straight = curve.places @ curve.energy @ curve.places
    assert straight == pytest.approx(1.0)  # no bending, unit speed
