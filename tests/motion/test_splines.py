"""Cubic polynomials and splines of joints over time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import MotionLimits, fk, jacobian
from trocar.errors import TrocarError
from trocar.motion import ArmMotion, limit_use, plan_through, vertical_deviation_m
from trocar.motion import splines as module
from trocar.motion.splines import CubicGrid
from trocar.trajectory import Trajectory
from waypoints import FOUR, PAPER, PSM


def one_joint(velocity=1e3, acceleration=1e3):
    return MotionLimits(np.array([velocity]), np.array([acceleration]))


def grid_of(waypoints, limits, batch=1, first_s=0.1, step_s=0.05, longest_s=2.0):
    return CubicGrid.build(
        np.array(waypoints, dtype=float).reshape(len(waypoints), -1),
        limits,
        first_s=first_s,
        step_s=step_s,
        longest_s=longest_s,
        batch=batch,
    )


def test_the_grid_starts_at_the_first_duration_and_ends_with_none():
    grid = grid_of([0.0, 1.0], one_joint(), first_s=0.3, step_s=0.2, longest_s=1.0)
    np.testing.assert_allclose(grid.times_s, [0.3, 0.5, 0.7, 0.9, 1.1, np.inf])
    assert grid_of([0.0, 1.0], one_joint(), first_s=0.3, step_s=0.2, longest_s=0.05).times_s.tolist() == [0.3, np.inf]


@pytest.mark.parametrize(
    ("limits", "least_s"),
    [
        (one_joint(velocity=1.0), 0.9),  # 1.5 d / t
        (one_joint(acceleration=4.0), np.sqrt(0.9)),  # 6 d / t^2
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_from_rest_to_rest_a_limit_is_met_exactly(limits, least_s, sign):
    rest = np.zeros((1, 2, 1))
    for share, found_s in ((1 - 1e-6, least_s * (1 - 1e-6) + 0.05), (1 + 1e-6, least_s * (1 + 1e-6))):
        grid = grid_of([0.0, sign * 0.6], limits, first_s=share * least_s)
        assert grid.shortest(rest)[0, 0] == pytest.approx(found_s)


@pytest.mark.parametrize("way", [0.5, -0.5])
@pytest.mark.parametrize("mirrored", [False, True])
def test_both_ends_accelerate_within_the_limit(mirrored, way):
    """From 1 /s to rest: 6 d / t^2 - 4 v / t at the start, -6 d / t^2 + 2 v / t at the end; or time backwards."""
    velocities = np.array([[[1.0], [0.0]]])
    if mirrored:
        velocities = velocities[:, ::-1]
    for t in (0.2, 0.5, 0.8):
        start, end = 6 * way / t**2 - 4 / t, -6 * way / t**2 + 2 / t
        most = max(abs(start), abs(end))
        for acceleration, kept in ((1.001 * most, True), (0.999 * most, False)):
            grid = grid_of([0.0, way], one_joint(acceleration=acceleration), first_s=t, longest_s=t)
            assert (grid.shortest(velocities)[0, 0] == t) == kept
        motion = Trajectory.hermite([0.0, t], [[0.0], [way]], velocities[0])
        found = [abs(motion(when, 2)[0]) for when in (0.0, np.nextafter(t, 0))]
        assert max(found) == pytest.approx(most)


def test_a_velocity_between_the_ends_counts_and_so_does_one_at_an_end():
    """1.5 d / t - (v0 + v1) / 4 in the middle, where both ends are as fast."""
    both = np.full((1, 2, 1), 0.4)
    peak = 1.5 * 0.6 / 1.0 - 0.2
    for velocity, kept in ((1.001 * peak, True), (0.999 * peak, False)):
        grid = grid_of([0.0, 0.6], one_joint(velocity=velocity), first_s=1.0, longest_s=1.0)
        assert (grid.shortest(both)[0, 0] == 1.0) == kept
    for velocity, kept in ((0.401, True), (0.399, False)):
        for ends in ([0.4, 0.0], [0.0, 0.4], [-0.4, 0.0], [0.0, -0.4]):
            grid = grid_of([0.0, 0.0], one_joint(velocity=velocity), first_s=1.0, longest_s=1.0)
            assert (grid.shortest(np.array(ends)[None, :, None])[0, 0] == 1.0) == kept


def test_every_segment_of_every_plan_in_a_batch_is_told_by_itself():
    rng = np.random.default_rng(0)
    waypoints = rng.uniform(-0.3, 0.3, (4, 3))
    limits = MotionLimits(np.array([0.5, 0.7, 0.9]), np.array([2.0, 3.0, 4.0]))
    velocities = 0.3 * rng.uniform(-1, 1, (5, 4, 3))
    found = grid_of(waypoints, limits, batch=5).shortest(velocities)
    assert found.shape == (5, 3) and np.isfinite(found).sum() > 10 and len(np.unique(found)) > 4
    for plan, segment in np.ndindex(5, 3):
        alone = grid_of(waypoints[segment : segment + 2], limits)
        assert alone.shortest(velocities[plan, None, segment : segment + 2])[0, 0] == found[plan, segment]


def test_where_no_duration_will_do_there_is_none():
    grid = grid_of([0.0, 1.0], one_joint(velocity=0.1), longest_s=1.0)
    assert grid.shortest(np.zeros((1, 2, 1)))[0, 0] == np.inf
    fast = grid_of([0.0, 0.0], one_joint(velocity=0.1))
    assert fast.shortest(np.full((1, 2, 1), 0.2))[0, 0] == np.inf  # faster at its ends than is allowed


SLACK = 0.02  # two recorded waypoints lie 0.3 mm beyond the nominal insertion


def test_recorded_lengths_come_out_again(recordings):
    """Hwang et al. 2022: `cubic_samples` are the lengths that their robot ran, in samples of 10 ms."""
    with np.load(recordings / "dvrk/motion/reference_waypoints.npz") as data:
        waypoints, recorded = data["waypoints"], data["cubic_samples"]
    plans = [plan_through(PSM, four, PAPER, range_slack=SLACK) for four in waypoints]
    assert all(plan.found for plan in plans)
    samples = np.array([round(100 * plan.duration_s) for plan in plans])
    assert np.abs(samples - recorded).max() <= 1
    assert np.mean([plan.duration_s for plan in plans]) == pytest.approx(1.6972727, abs=1e-7)  # ours: no change
    asked = [ArmMotion(PSM, four, PAPER) for four in waypoints]
    off = [vertical_deviation_m(arm, plan.paths[PSM.name]) for arm, plan in zip(asked, plans, strict=True)]
    assert max(off) < 1.3e-3  # facts: up to 1.24 mm
    assert all(plan.bound_s < plan.duration_s for plan in plans)


@pytest.mark.parametrize("still", [False, True])
def test_inner_waypoints_are_passed_along_up_without_turning_or_with_the_wrist_at_rest(still):
    up = np.array([0.2, -0.1, 1.0])
    plan = plan_through(PSM, FOUR, PAPER, up=up, fixed_wrist=still)
    for t, q in zip(plan.waypoint_times_s[PSM.name][1:3], FOUR[1:3], strict=True):
        velocity = plan.trajectory(t, 1)
        twist = jacobian(PSM, q) @ velocity
        assert np.linalg.norm(twist[:3]) > 0.001
        np.testing.assert_allclose(np.cross(twist[:3], up), 0, atol=1e-9)
        np.testing.assert_allclose(velocity[3:] if still else twist[3:], 0, atol=1e-9)


def test_approach_from_above_ends_vertically():
    plan = plan_through(PSM, FOUR[1:], PAPER)
    tips = fk(PSM, plan.trajectory(np.linspace(*plan.waypoint_times_s[PSM.name][1:], 200))).translation_m
    assert np.linalg.norm((tips - tips[-1])[:, :2], axis=1).max() < 1.5e-3


def test_a_start_that_moves_towards_the_next_waypoint_saves_time_and_one_that_moves_away_costs_some():
    towards = 0.2 * (FOUR[1] - FOUR[0]) / np.abs(FOUR[1] - FOUR[0]).max()
    ahead, resting, away = (plan_through(PSM, FOUR, PAPER, start_velocity=k * towards) for k in (1, 0, -1))
    assert ahead.found and resting.found and away.found
    assert ahead.duration_s < resting.duration_s < away.duration_s
    np.testing.assert_allclose(ahead.trajectory(0.0, 1), towards, atol=1e-12)


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
        use = limit_use(PSM, Trajectory.hermite([0, t], q, velocities), limits)
        return use.velocity_ratio <= slack and use.acceleration_ratio <= slack

    tried = grid.times_s[:-1]
    if np.isfinite(found):
        assert kept(found, 1 + 1e-9)
    assert not any(kept(t, 1 - 1e-5) for t in tried[tried < found])


def test_durations_are_found_however_long_they_are():
    """At rest at both ends: 1.5 d / v, on a grid of half seconds that grows until all are found."""
    for seconds in (0.5, 3.0, 9.0, 65.0, 119.5):
        q = PSM.middle + np.outer([0, 1], [0.3, 0, 0, 0, 0, 0])
        limits = MotionLimits(np.full(6, 1.5 * 0.3 / (seconds - 0.1)), np.full(6, 1e3))
        found = module._shortest(q, np.zeros((1, 2, 6)), limits, 0.5, 0.5)
        assert found == pytest.approx(np.array([[seconds]]))
    slow = MotionLimits(np.full(6, 1.5 * 0.3 / 121.0), np.full(6, 1e3))
    with pytest.raises(TrocarError, match="no cubic of up to 120 s joins the waypoints"):
        module._shortest(q, np.zeros((1, 2, 6)), slow, 1.0, 1.0)


def test_directions_of_passing_are_unit_vectors_and_lift_the_tip():
    for still in (False, True):
        found = module._passing_directions(ArmMotion(PSM, FOUR, PAPER, fixed_wrist=still))
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
        assert np.all(np.einsum("nj,nj->n", jacobian(PSM, FOUR[1:3])[:, 2], found) > 0)
    assert module._passing_directions(ArmMotion(PSM, FOUR[:2], PAPER)).shape == (0, 6)
    points = FOUR.copy()
    points[1] = 0.0, np.pi / 2, 0.1, 0.0, 0.0, 0.0  # the shaft lies on the first joint's axis
    with pytest.raises(TrocarError, match="is singular at an inner waypoint"):
        module._passing_directions(ArmMotion(PSM, points, PAPER))


def test_no_passing_speeds_near_those_that_were_found_take_much_less_time():
    arm = ArmMotion(PSM, FOUR, PAPER)
    directions = module._passing_directions(arm)
    best = module._descend(arm, directions)

    def seconds(speeds):
        velocities = module._velocities(np.zeros(6), speeds[None], directions)
        return module._shortest(FOUR, velocities, PAPER, 0.3, 0.02).sum()

    assert seconds(best) < seconds(0 * best) - 0.1
    assert np.all(np.abs(best[:, None] * directions) <= PAPER.velocity)
    for aside in (-0.2, -0.1, 0.1, 0.2):
        for k in range(2):
            assert seconds(best + aside * np.eye(2)[k]) >= seconds(best) - 0.021  # a step of the grid
