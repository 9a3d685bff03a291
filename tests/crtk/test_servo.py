"""Streams of set-points: played back exactly where they keep the limits, and within the limits where they do not."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.arms import MotionLimits
from trocar.crtk.servo import DELAY_S, SetPoints, step_towards
from trocar.robots import TICK_S

LIMITS = MotionLimits(np.array([1.0, 0.5]), np.array([8.0, 4.0]))
ZERO = np.zeros(2)


def played(stream, seconds, start=ZERO):
    """Return what an arm is commanded at each tick: positions and velocities (n, 2); ``stream`` yields (time, q)."""
    points, q, velocity, rows, goal = SetPoints(), start, ZERO, [(start, ZERO)], None
    waiting = list(stream)
    for tick in range(round(seconds / TICK_S)):
        now_s = 100.0 + tick * TICK_S
        while waiting and waiting[0][0] <= now_s:
            came_s, stamp_s, to = waiting.pop(0)
            points.add(np.array(to), q, came_s, stamp_s)
        before, goal = goal, points.at(now_s)
        if goal is not None:
            move = step_towards(goal, (goal - (goal if before is None else before)) / TICK_S, q, velocity, LIMITS)
            q, velocity = move(TICK_S), move(TICK_S, 1)
        rows.append((q, velocity))
    return map(np.array, zip(*rows, strict=True))


def keeps_limits(q):
    velocity = np.diff(q, axis=0) / TICK_S
    change = np.diff(velocity, axis=0, prepend=ZERO[None]) / TICK_S
    return (np.abs(velocity) / LIMITS.velocity).max() <= 1 + 1e-9 and (
        np.abs(change) / LIMITS.acceleration
    ).max() <= 1 + 1e-6


def smooth(t_s):
    return np.array([0.1, 0.03]) * (1 - np.cos(5 * t_s))


@pytest.mark.parametrize(("rate_hz", "phase_s"), [(100, 0.0), (100, 0.0037), (200, 0.001), (500, 0.0)])
def test_a_stream_within_the_limits_is_played_back_as_its_sender_timed_it(rate_hz, phase_s):
    times = np.arange(0, 2, 1 / rate_hz)
    rng = np.random.default_rng(3)
    late = rng.uniform(0.0005, DELAY_S / 3, len(times))  # of the network
    late[:3] = 0.0005  # the fastest of them tell how the clocks differ
    came = np.maximum.accumulate(100.0 + phase_s + times + late)
    q, _ = played([(at, 7.0 + t, smooth(t)) for at, t in zip(came, times, strict=True)], 2.5)
    assert keeps_limits(q)
    shift = phase_s + late[0] + DELAY_S
    clock = TICK_S * np.arange(len(q)) - TICK_S - shift  # of the stream, at each tick
    ticks = np.array([np.interp(clock, times, smooth(times[:, None])[:, joint]) for joint in range(2)]).T
    inside = (clock[1:] > 0.3) & (clock[1:] < 1.9)
    assert np.abs(q[1:] - (ticks[:-1] + ticks[1:]) / 2)[inside].max() < 1e-9
    assert np.abs(q[-1] - smooth(times[-1])).max() < 1e-9


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_whatever_is_streamed_the_limits_are_kept_and_the_last_set_point_is_reached(data):
    goals = data.draw(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=12))
    gaps = data.draw(st.lists(st.floats(0.0, 0.4), min_size=len(goals), max_size=len(goals)))
    times = 100.0 + np.cumsum(gaps)
    stamps = data.draw(st.sampled_from(["none", "true", "constant"]))
    stamp = {"none": lambda t: None, "true": lambda t: t - 50.0, "constant": lambda t: 1.0}[stamps]
    q, velocity = played([(t, stamp(t), goal) for t, goal in zip(times, goals, strict=True)], times[-1] - 100.0 + 12.0)
    assert keeps_limits(q)
    assert np.abs(q[-1] - goals[-1]).max() < 1e-9 and np.abs(velocity[-1]).max() < 1e-9


def test_a_step_is_approached_without_overshoot_in_the_shortest_time():
    q, _ = played([(100.0, None, (0.5, 0.0))], 1.5)
    assert q[:, 0].max() <= 0.5 + 1e-12
    shortest_s = 0.5 / LIMITS.velocity[0] + LIMITS.velocity[0] / LIMITS.acceleration[0]
    arrived = np.flatnonzero(q[:, 0] > 0.5 - 1e-9)[0] * TICK_S
    assert shortest_s <= arrived <= shortest_s + 0.06


@given(stall_s=st.floats(0.0, 0.3), at_s=st.floats(0.05, 0.6), sharp=st.floats(0.3, 1.0))
@settings(max_examples=60, deadline=None)
def test_a_stream_that_was_held_up_is_caught_up_with_and_its_end_is_not_overshot(stall_s, at_s, sharp):
    """It accelerates and brakes with ``sharp`` of the limit; nothing comes for a while, then all at once."""
    change, end_m = sharp * LIMITS.acceleration[0], 0.3
    half_s = np.sqrt(end_m / change)
    times = np.arange(0, 2 * half_s + 0.01, 0.01)
    q = np.where(times < half_s, change * times**2 / 2, end_m - change * np.maximum(2 * half_s - times, 0) ** 2 / 2)
    speeds = np.diff(q) / 0.01
    assume(speeds.max() < LIMITS.velocity[0])
    came = np.where((times > at_s) & (times < at_s + stall_s), at_s + stall_s, times)
    stream = [(100.0 + c, 1.0 + t, (x, 0.0)) for c, t, x in zip(came, times, q, strict=True)]
    driven, _ = played(stream, 3.0)
    assert keeps_limits(driven)
    assert driven[:, 0].max() < end_m + 1e-3
    assert driven[-1, 0] == pytest.approx(end_m, abs=1e-9)


@pytest.mark.parametrize("stamped", [True, False])
@given(seed=st.integers(0, 1000), phase_s=st.floats(0.0, 0.009))
@settings(max_examples=40, deadline=None)
def test_a_sender_whose_timer_errs_by_a_tenth_of_its_period_is_followed_to_its_goal(stamped, seed, phase_s):
    """It rests, then accelerates and brakes with all of the limit: one tick of too little braking would be too much."""
    rng, end_m = np.random.default_rng(seed), 0.3
    half_s = np.sqrt(end_m / LIMITS.acceleration[0])
    times = np.arange(-1.0, 2 * half_s + 0.5, 0.01)
    change = LIMITS.acceleration[0] / 2
    q = np.where(times < half_s, change * times.clip(0) ** 2, end_m - change * (2 * half_s - times).clip(0) ** 2)
    sent = times + rng.uniform(0.0, 1e-3, len(times))
    came = np.maximum.accumulate(101.0 + phase_s + sent + rng.uniform(0.0, 2e-4, len(times)))
    stream = [(c, 7.0 + t if stamped else None, (x, 0.0)) for c, t, x in zip(came, sent, q, strict=True)]
    driven, _ = played(stream, 3.0)
    assert keeps_limits(driven)
    assert driven[:, 0].max() < end_m + 5e-4
    assert driven[-1, 0] == pytest.approx(end_m, abs=1e-9)


def test_a_stream_that_breaks_off_is_braked_and_returns_to_its_last_set_point():
    times = np.arange(0, 0.3, 0.01)
    q, _ = played([(100.0 + t, 1.0 + t, (0.9 * t, 0.0)) for t in times], 1.5)
    assert keeps_limits(q)
    assert q[-1, 0] == pytest.approx(0.9 * times[-1], abs=1e-9)
    assert q[:, 0].max() - q[-1, 0] < 1.2 * 0.9**2 / (2 * LIMITS.acceleration[0])


def test_a_motion_whose_next_step_never_comes_ends_at_rest_within_the_limits():
    move = step_towards(np.array([0.01, 0.0]), np.array([1.0, 0.0]), ZERO, np.array([1.0, 0.0]), LIMITS)
    times = np.arange(0, move.duration_s, 1e-3)
    assert np.abs(move(times, 2)).max() <= LIMITS.acceleration[0] + 1e-9
    assert move(move.duration_s, 1) == pytest.approx(ZERO, abs=1e-12)
