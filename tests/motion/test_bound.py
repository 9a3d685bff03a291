import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from trocar.arms import MotionLimits
from trocar.motion import duration_bound_s, move_to, plan_through, shortest_rest_to_rest_s, shortest_to_rest_s
from waypoints import FOUR, PAPER, PSM


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


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_plan_beats_the_bound(seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.4, 0.4, 6) * PAPER.velocity
    plan = plan_through(PSM, FOUR + rng.uniform(-0.01, 0.01, (4, 6)), PAPER, start_velocity=start, range_slack=9.0)
    assert plan.found
    assert plan.bound_s <= plan.duration_s


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=6), st.floats(0.1, 10), st.floats(0.1, 10))
def test_an_inner_waypoint_never_shortens_a_motion(values, velocity, acceleration):
    limits = one_joint(velocity, acceleration)
    q = np.array(values)[:, None]
    assert duration_bound_s(q[[0, -1]], limits) <= duration_bound_s(q, limits) * (1 + 1e-12)


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
