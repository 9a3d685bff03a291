import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits, fk, ik, jacobian
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import (
    PLANNERS,
    assess_transfer,
    duration_bound_s,
    limit_use,
    plan_through,
    plan_transfer,
)
from trocar.motion.cubic import CubicGrid
from trocar.trajectory import Trajectory

ARM = ARMS["psm-classic"]
LIMITS = MOTION_LIMITS["paper"]
SLACK = 0.02  # two recorded waypoints lie 0.3 mm beyond the nominal insertion


def transfer_waypoints():
    """Grasp, lifted, over the target, lowered: tips as on the board, turned a little on the way."""
    places_m = [
        [0.140, -0.020, -0.155],
        [0.140, -0.020, -0.115],
        [0.100, 0.020, -0.115],
        [0.100, 0.020, -0.145],
    ]
    turns = SO3.axis("z", [0.5, 0.5, -0.2, -0.2])
    return ik(ARMS["psm-classic"], SE3.from_parts(turns, places_m))


FOUR = transfer_waypoints()


def test_recorded_lengths_come_out_again(recordings):
    """Hwang et al. 2022: `cubic_samples` are the lengths that their robot ran, in samples of 10 ms."""
    with np.load(recordings / "dvrk/motion/reference_waypoints.npz") as data:
        waypoints, recorded = data["waypoints"], data["cubic_samples"]
    plans = [plan_transfer(ARM, four, LIMITS, range_slack=SLACK) for four in waypoints]
    samples = np.array([round(100 * plan.trajectory.duration_s) for plan in plans])
    assert np.abs(samples - recorded).max() <= 1
    quality = [assess_transfer(ARM, plan, LIMITS) for plan in plans]
    assert max(q.max_acceleration_ratio for q in quality) <= 1 + 1e-9
    assert max(q.vertical_deviation_m for q in quality) < 1.3e-3  # facts: up to 1.24 mm
    assert all(q.bound_s < q.duration_s for q in quality)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_transfer_passes_its_waypoints_within_limits(planner):
    plan = plan_transfer(ARM, FOUR, LIMITS, planner=planner)
    np.testing.assert_allclose(plan.trajectory(plan.waypoint_times_s), FOUR, atol=1e-9)
    np.testing.assert_allclose(plan.trajectory(plan.waypoint_times_s[[0]], 1), 0, atol=1e-9)
    assert limit_use(ARM, plan.trajectory, LIMITS).kept
    assert plan.trajectory.duration_s > duration_bound_s(FOUR, LIMITS)


def test_inner_waypoints_are_passed_along_up_without_turning():
    up = np.array([0.2, -0.1, 1.0])
    plan = plan_transfer(ARM, FOUR, LIMITS, up=up)
    for t, q in zip(plan.waypoint_times_s[1:3], FOUR[1:3], strict=True):
        twist = jacobian(ARM, q) @ plan.trajectory(t, 1)
        assert np.linalg.norm(twist[:3]) > 0.001
        np.testing.assert_allclose(np.cross(twist[:3], up), 0, atol=1e-9)
        np.testing.assert_allclose(twist[3:], 0, atol=1e-9)


def test_passing_speeds_save_time():
    stopping = sum(plan_through(ARM, FOUR[k : k + 2], LIMITS).trajectory.duration_s for k in range(3))
    assert plan_transfer(ARM, FOUR, LIMITS).trajectory.duration_s < 0.9 * stopping


def test_approach_from_above_ends_vertically():
    plan = plan_through(ARM, FOUR[1:], LIMITS)
    tips = fk(ARM, plan.trajectory(np.linspace(*plan.waypoint_times_s[1:], 200))).translation_m
    assert np.linalg.norm((tips - tips[-1])[:, :2], axis=1).max() < 1.5e-3


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.05, 4))
def test_the_grid_finds_what_a_plain_search_finds(seed, scale):
    """Closed-form extremes on the grid against cubics sampled at 1 kHz, one duration at a time."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.3, 0.3, (2, 6))
    limits = MotionLimits(rng.uniform(0.3, 1.0, 6), rng.uniform(1.0, 5.0, 6))
    velocities = np.clip(scale * rng.uniform(-0.3, 0.3, (2, 6)), -limits.velocity, limits.velocity)
    grid = CubicGrid.build(q, limits, first_s=0.1, step_s=0.1, longest_s=4.0, batch=1)
    found = grid.shortest(velocities[None])[0, 0]

    def kept(t, slack):
        use = limit_use(ARM, Trajectory.hermite([0, t], q, velocities), limits)
        return use.velocity_ratio <= slack and use.acceleration_ratio <= slack

    tried = grid.times_s[:-1]
    if np.isfinite(found):
        assert kept(found, 1 + 1e-9)
    assert not any(kept(t, 1 - 1e-5) for t in tried[tried < found])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q: q[:3], r"shape \(4, 6\)"),
        (lambda q: q * [1, 1, np.nan, 1, 1, 1], "is nan"),
        (
            lambda q: q + np.array([0, 0, 0.1, 0, 0, 0]),
            r"waypoint 0, joint .* m is outside \[0.0000, 0.2400\]",
        ),
        (lambda q: q[[0, 1, 1, 3]], "waypoints 1 and 2 coincide"),
    ],
)
def test_bad_waypoints_are_one_sentence(change, words):
    with pytest.raises(TrocarError, match=words) as raised:
        plan_transfer(ARM, change(FOUR), LIMITS)
    assert "\n" not in str(raised.value)


def test_unknown_planner_and_direction_are_refused():
    with pytest.raises(TrocarError, match="choose one of: spline"):
        plan_transfer(ARM, FOUR, LIMITS, planner="magic")
    with pytest.raises(TrocarError, match="upward direction"):
        plan_transfer(ARM, FOUR, LIMITS, up=[0, 0, 0])
