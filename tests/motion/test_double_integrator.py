"""Least times and phases of a double integrator, and the bound that follows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from trocar.arms import MotionLimits
from trocar.motion import duration_bound_s, move_to
from trocar.motion.double_integrator import (
    after_gap_s,
    joined,
    least_acceleration,
    phases_between,
    phases_to_rest,
    shortest_between_s,
    shortest_common_s,
    shortest_rest_to_rest_s,
    shortest_to_rest_s,
)

V, A = 2.0, 4.0


def to_rest(distance, start, seconds):
    return [(round(t, 9), round(a, 9)) for t, a in phases_to_rest(distance, start, seconds, V, A)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_goes_on_waits_or_comes_back_as_the_time_asks(sign):
    def found(distance, start, seconds):
        return [(t, sign * a) for t, a in to_rest(sign * distance, sign * start, seconds)]

    assert found(1.0, 0.0, 1.0) == [(0.5, 4.0), (0.5, -4.0)]  # bang-bang
    assert found(1.0, 0.0, 2.0) == [(1.0, 1.0), (1.0, -1.0)]  # no more than the time asks for
    assert found(4.0, 0.0, 2.5) == [(0.5, 4.0), (1.5, 0.0), (0.5, -4.0)]  # at the limit in between
    assert found(0.125, 1.0, 0.25) == [(0.0, 4.0), (0.25, -4.0)]  # brakes at once: all that it may
    assert found(0.25, 1.0, 0.5) == [(0.0, 2.0), (0.5, -2.0)]  # evenly, to the goal in time
    assert found(0.25, 1.0, 0.8) == [(0.5, -2.0), (pytest.approx(0.3), 0.0)]  # stops there sooner, and waits
    assert found(0.0, 1.0, 0.25 + 2 * np.sqrt(0.125 / 4)) == [
        (0.25, -4.0),
        (pytest.approx(np.sqrt(0.125 / 4)), pytest.approx(-4.0)),
        (pytest.approx(np.sqrt(0.125 / 4)), pytest.approx(4.0)),
    ]
    assert found(1.0, 2.0, 0.75) == [(0.0, 4.0), (0.25, 0.0), (0.5, -4.0)]  # cruises, then brakes


def test_a_joint_that_is_where_it_should_be_stays():
    assert phases_to_rest(0.0, 0.0, 0.7, V, A) == [(0.7, 0.0)]
    assert phases_to_rest(1e-15, 0.0, 0.7, V, A) == [(0.7, 0.0)]
    assert len(phases_to_rest(3e-15, 0.0, 0.7, V, A)) == 2
    assert phases_to_rest(0.0, 1e-13, 0.7, V, A) == [(0.7, 0.0)]  # rounding is no motion


def test_joints_whose_phases_end_at_other_times_are_joined():
    q, v = np.array([1.0, 2.0]), np.array([0.0, 0.5])
    phases = [[(0.5, 4.0), (0.5, -4.0)], [(0.2, 1.0), (0.8, -0.5)]]
    motion = joined(q, v, phases, 1.0)
    np.testing.assert_allclose(motion.times_s, [0.0, 0.2, 0.5, 1.0])
    times = np.array([0.0, 0.1, 0.2, 0.4, 0.6, 0.9])
    first = np.where(times < 0.5, 2 * times**2, 0.5 + 2.0 * (times - 0.5) - 2 * (times - 0.5) ** 2)
    second = np.where(times < 0.2, 0.5 * times + times**2 / 2, 0.12 + 0.7 * (times - 0.2) - (times - 0.2) ** 2 / 4)
    np.testing.assert_allclose(motion(times), q + np.stack([first, second], axis=1))


def test_ends_of_phases_that_are_nearly_one_are_one_knot():
    close = [[(0.3, 1.0), (0.7, -1.0)], [(0.3 + 5e-10, 1.0), (0.7, 0.0)], [(1.0 - 5e-10, 1.0), (5e-10, 0.0)]]
    close += [[(5e-10, 1.0), (1.0, 0.0)], [(0.6, 0.0), (0.4, 0.0)]]
    motion = joined(np.zeros(5), np.zeros(5), close, 1.0)
    np.testing.assert_allclose(motion.times_s, [0.0, 0.3, 0.6, 1.0], atol=1e-8)
    np.testing.assert_allclose(motion(0.9, 2), [-1.0, 0.0, 1.0, 0.0, 0.0])
    apart = joined(np.zeros(2), np.zeros(2), [[(0.3, 1.0), (0.7, -1.0)], [(0.3 + 3e-9, 1.0), (0.7, 0.0)]], 1.0)
    assert len(apart.times_s) == 4


SHARES = st.floats(-1, 1).map(lambda share: round(share, 3))
states = st.tuples(st.floats(-3, 3), SHARES, SHARES, st.floats(0.1, 2), st.floats(0.1, 5)).map(
    lambda s: (round(s[0], 6), s[1] * s[3], s[2] * s[3], s[3], s[4])
)
seeds = st.integers(0, 2**32 - 1)
INTEGRAL = 1e-5
"""Of envelopes that bend between two of 20,000 samples."""


def reach(t, v0, v1, velocity, acceleration):
    """Return the least and the greatest distance that can be covered in a time; none: (inf, -inf)."""
    if abs(v1 - v0) > acceleration * t * (1 + 1e-12):
        return np.inf, -np.inf
    s = np.linspace(0, t, 20001)
    up = np.minimum(velocity, np.minimum(v0 + acceleration * s, v1 + acceleration * (t - s)))
    down = np.maximum(-velocity, np.maximum(v0 - acceleration * s, v1 - acceleration * (t - s)))
    return np.trapezoid(down, s), np.trapezoid(up, s)


@given(states)
def test_the_shortest_time_is_enough_and_no_shorter_one_is(state):
    d, v0, v1, v, a = state
    shortest = float(shortest_between_s(*state))
    least, most = reach(shortest, v0, v1, v, a)
    assert least - INTEGRAL <= d <= most + INTEGRAL
    for share in (0.3, 0.7, 0.95, 0.999):
        least, most = reach(share * shortest, v0, v1, v, a)
        assert not least + INTEGRAL < d < most - INTEGRAL


@given(states, st.floats(1.0001, 4))
def test_the_least_acceleration_of_a_longer_time_just_reaches(state, longer):
    d, v0, v1, v, a = state
    t = longer * float(shortest_between_s(*state)) + 1e-3
    least = float(least_acceleration(d, v0, v1, t, v))
    enough = least <= a
    least_m, most_m = reach(t, v0, v1, v, a)
    assume(min(abs(d - least_m), abs(d - most_m)) > INTEGRAL)
    assert enough == (least_m <= d <= most_m)
    if np.isfinite(least) and least > 1e-3:
        low, high = reach(t, v0, v1, v, 0.99 * least)
        assert not low + INTEGRAL < d < high - INTEGRAL


@given(states)
def test_the_gap_lies_between_rushing_through_and_coming_back(state):
    """In a gap no acceleration will do; after it every longer time will."""
    d, v0, v1, v, a = state
    shortest, after = float(shortest_between_s(*state)), float(after_gap_s(d, v0, v1, a))
    assume(shortest > 1e-6)
    for t in (after, 1.1 * after, 2 * after, 5 * after):
        if t > shortest:
            assert least_acceleration(d, v0, v1, t, v) <= a * (1 + 1e-6)
    if after == 0.0:
        for share in (1.01, 1.5, 3.0):
            assert least_acceleration(d, v0, v1, share * shortest, v) <= a * (1 + 1e-6)


def test_a_joint_that_rushes_through_can_be_quick_or_late_and_nothing_between():
    """0.1 m from 1 m/s to 1 m/s at 1 m/s^2: 0.095 s; to stop and come back takes 3.8 s."""
    state = (0.1, 1.0, 1.0, 2.0, 1.0)
    quick, late = float(shortest_between_s(*state)), float(after_gap_s(0.1, 1.0, 1.0, 1.0))
    assert float(after_gap_s(-0.1, -1.0, -1.0, 1.0)) == pytest.approx(late)
    assert quick == pytest.approx(0.0976, abs=1e-3) and late == pytest.approx(2 + 2 * np.sqrt(0.9), abs=1e-6)
    for t in np.linspace(0.2, late - 0.1, 10):
        assert least_acceleration(*state[:3], t, 2.0) > 1.0
    slow = (2.0, 0.0, 0.0, 2.0, 1.0)  # another joint that needs 2.83 s, which falls into the gap
    both = np.array([state, slow]).T
    assert shortest_common_s(*both) == pytest.approx(late)


@given(st.floats(-3, 3), SHARES, st.floats(0.1, 2), st.floats(0.1, 5))
def test_from_rest_and_to_rest_the_known_closed_forms_come_out(d, share, v, a):
    assert shortest_between_s(d, 0.0, 0.0, v, a) == pytest.approx(shortest_rest_to_rest_s(abs(d), v, a), rel=1e-9)
    start = share * v
    known = float(shortest_to_rest_s(d, start, v, a))
    assert shortest_between_s(d, start, 0.0, v, a) == pytest.approx(known, rel=1e-6, abs=1e-6)
    assert shortest_between_s(-d, 0.0, -start, v, a) == pytest.approx(known, rel=1e-6, abs=1e-6)  # time backwards


@given(seeds)
def test_phases_join_both_states_in_the_common_time_within_the_limits(seed):
    rng = np.random.default_rng(seed)
    velocity, acceleration = rng.uniform(0.1, 2, 6), rng.uniform(0.1, 5, 6)
    distance, (v0, v1) = rng.uniform(-2, 2, 6), rng.uniform(-1, 1, (2, 6)) * velocity
    seconds = float(shortest_common_s(distance, v0, v1, velocity, acceleration))
    assert np.isfinite(seconds) and seconds >= shortest_between_s(distance, v0, v1, velocity, acceleration).max()
    for d, start, end, v, a in zip(distance, v0, v1, velocity, acceleration, strict=True):
        place, speed = 0.0, start
        phases = phases_between(d, start, end, seconds, v)
        for t, push in phases:
            assert t >= 0 and abs(push) <= a * (1 + 1e-6)
            place += speed * t + push * t**2 / 2
            speed += push * t
            assert abs(speed) <= v * (1 + 1e-6)
        assert sum(t for t, _ in phases) == pytest.approx(seconds, abs=1e-8)
        assert place == pytest.approx(d, abs=1e-6) and speed == pytest.approx(end, abs=1e-6)


def test_a_joint_that_stays_has_one_still_phase():
    assert phases_between(0.0, 0.0, 0.0, 0.7, 1.0) == [(0.7, 0.0)]
    assert phases_between(0.5, 0.5, 0.5, 1.0, 1.0) == [(1.0, 0.0)]


def test_a_gap_begins_where_rushing_through_would_be_too_quick_by_hand():
    """At 2 /s^2, from .6 /s to .8 /s over .09: back as fast as sqrt(.5 - .18), (.6 + .8 + 2 sqrt(.32)) / 2 s."""
    assert after_gap_s(0.09, 0.6, 0.8, 2.0) == pytest.approx((1.4 + 2 * np.sqrt(0.32)) / 2)
    assert after_gap_s(0.09, -0.6, 0.8, 2.0) == pytest.approx((0.2 + 2 * np.sqrt(0.32)) / 2)
    assert after_gap_s(0.24, 0.6, 0.8, 2.0) > 0 and after_gap_s(0.26, 0.6, 0.8, 2.0) == 0.0


def test_joints_of_many_motions_are_told_by_themselves():
    """Some of them fall into a gap, where all must wait for the joint that comes back."""
    rng = np.random.default_rng(0)
    velocity, acceleration = np.array([1.0, 2.0, 1.5]), np.array([2.0, 1.0, 3.0])
    distance, (v0, v1) = rng.uniform(0.0, 0.2, (4, 5, 3)), rng.uniform(0.5, 1, (2, 4, 5, 3)) * velocity
    distance[..., 2], v0[..., 1:], v1[..., 1:] = 0.75, 0.0, 0.0
    found = shortest_common_s(distance, v0, v1, velocity, acceleration)
    waited = 0
    for place in np.ndindex(4, 5):
        alone = shortest_common_s(distance[place], v0[place], v1[place], velocity, acceleration)
        assert found[place] == alone
        waited += alone > shortest_between_s(distance[place], v0[place], v1[place], velocity, acceleration).max()
    assert waited > 3


def one_joint(velocity=2.0, acceleration=4.0):
    return MotionLimits(np.array([velocity]), np.array([acceleration]))


def test_bang_bang_and_trapezoid():
    assert shortest_rest_to_rest_s(0.25, 2.0, 4.0) == pytest.approx(0.5)  # 2 sqrt(d / a)
    assert shortest_rest_to_rest_s(5.0, 2.0, 4.0) == pytest.approx(3.0)  # d / v + v / a


def test_waypoints_on_the_way_are_free_and_turns_cost_a_stop():
    limits = one_joint()
    through = duration_bound_s([[0.0], [0.1], [0.1], [0.25]], limits)
    assert through == pytest.approx(0.5)
    assert duration_bound_s([[0.0], [0.25], [0.0]], limits) == pytest.approx(1.0)


@pytest.mark.parametrize("start", [0.0, 0.9, -0.9, 1.9])
def test_no_discretised_motion_beats_the_bound(start):
    """A linear programme over accelerations cannot visit the waypoints in less time.

    From 1.9 /s the joint cannot stop before .45, beyond the turn at .2; from -.9 it first goes back by .1.
    """
    limits, values = one_joint(), [0.0, 0.2, 0.05, 0.3]
    bound = duration_bound_s(np.array(values)[:, None], limits, [start])
    count = 16

    def feasible(total_s):
        h = total_s / count
        lower = np.tril(np.ones((count, count)))
        speed = h * lower
        place = h * h * (lower @ lower - lower / 2)
        gone = start * h * np.arange(1, count + 1)
        return any(
            linprog(
                np.zeros(count),
                A_ub=np.concatenate([speed, -speed]),
                b_ub=np.concatenate([np.full(count, 2.0 - start), np.full(count, 2.0 + start)]),
                A_eq=np.stack([place[i], place[j], place[-1], speed[-1]]),
                b_eq=[0.2 - gone[i], 0.05 - gone[j], 0.3 - gone[-1], -start],
                bounds=(-4.0, 4.0),
            ).status
            == 0
            for i in range(1, count - 4)
            for j in range(i + 1, count - 2)
        )

    assert not feasible(0.97 * bound)
    assert feasible(1.10 * bound)


def test_braking_going_on_and_coming_back():
    v, a = 2.0, 4.0
    assert shortest_to_rest_s(0.125, 1.0, v, a) == pytest.approx(0.25)  # stops there
    assert shortest_to_rest_s(0.0, 1.0, v, a) == pytest.approx(0.25 + 2 * np.sqrt(0.125 / a))  # comes back
    assert shortest_to_rest_s(-0.125, -1.0, v, a) == pytest.approx(0.25)
    assert shortest_to_rest_s(0.5, 1.0, v, a) == pytest.approx((2 * np.sqrt(a * 0.5 + 0.5) - 1) / a)
    assert shortest_to_rest_s(9.0, 2.0, v, a) == pytest.approx(9 / 2 + 0.25)  # cruises, then brakes
    np.testing.assert_allclose(shortest_to_rest_s([3.0, -3.0], 0.0, v, a), shortest_rest_to_rest_s(3.0, v, a))


@settings(max_examples=60)
@given(st.lists(st.floats(-1, 1), min_size=2, max_size=5), st.floats(-1, 1), st.floats(0.1, 10), st.floats(0.1, 10))
def test_one_joint_through_waypoints_takes_no_less_than_from_stop_to_stop(values, share, velocity, acceleration):
    """The bound may not exceed what can be done: to the first waypoint from under way, then from rest to rest."""
    limits, start = one_joint(velocity, acceleration), np.array([share * velocity])
    q = np.array(values)[:, None]
    first = move_to(q[0], start, q[1], limits).duration_s
    rest = shortest_rest_to_rest_s(np.abs(np.diff(q[1:, 0])), velocity, acceleration).sum()
    bound = duration_bound_s(q, limits, start)
    assert bound <= (first + rest) * (1 + 1e-9) + 1e-9
    if len(q) == 2:
        assert bound == pytest.approx(first, rel=1e-9, abs=0.011)  # a move of no length holds for one period


def test_the_slowest_joint_decides():
    limits = MotionLimits(np.array([100.0, 100.0]), np.array([4.0, 1.0]))
    q = np.array([[0.0, 0.0], [1.0, 0.5]])
    assert duration_bound_s(q, limits) == pytest.approx(2 * np.sqrt(0.5))
    both = duration_bound_s(q, limits, [0.5, 0.0])
    assert both == pytest.approx(max(float(shortest_to_rest_s(1.0, 0.5, 100.0, 4.0)), 2 * np.sqrt(0.5)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_moving_joint_turns_at_the_end_of_its_run_or_where_it_can_stop(sign):
    limits = one_joint(velocity=100.0, acceleration=4.0)

    def bound(values, start):
        return duration_bound_s(sign * np.array(values)[:, None], limits, [sign * start])

    def to_rest(distance, start):
        return float(shortest_to_rest_s(distance, start, 100.0, 4.0))

    assert bound([0.0, 0.5, 1.0, 0.2], 2.0) == pytest.approx(to_rest(1.0, 2.0) + 2 * np.sqrt(0.8 / 4))
    assert bound([0.0, 0.3, 0.2], 2.0) == pytest.approx(0.5 + 2 * np.sqrt(0.3 / 4))  # it stops at .5 at the earliest
    assert bound([0.0, 0.5, 0.2], 2.0) == pytest.approx(0.5 + 2 * np.sqrt(0.3 / 4))
    assert bound([0.0, -0.3], 2.0) == pytest.approx(0.5 + 2 * np.sqrt(0.8 / 4))  # away first
    assert bound([0.0, 0.0, 1.0], 2.0) == pytest.approx(to_rest(1.0, 2.0))
