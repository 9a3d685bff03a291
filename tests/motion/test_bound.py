import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from trocar.arms import MotionLimits
from trocar.motion import duration_bound_s, shortest_rest_to_rest_s


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


def test_no_discretised_motion_beats_the_bound():
    """A linear programme over accelerations cannot visit the waypoints in less time."""
    limits, values = one_joint(), [0.0, 0.2, 0.05, 0.3]
    bound = duration_bound_s(np.array(values)[:, None], limits)
    count = 24

    def feasible(total_s):
        h = total_s / count
        lower = np.tril(np.ones((count, count)))
        speed = h * lower
        place = h * h * (lower @ lower - lower / 2)
        return any(
            linprog(
                np.zeros(count),
                A_ub=np.concatenate([speed, -speed]),
                b_ub=np.full(2 * count, 2.0),
                A_eq=np.stack([place[i], place[j], place[-1], speed[-1]]),
                b_eq=[0.2, 0.05, 0.3, 0.0],
                bounds=(-4.0, 4.0),
            ).status
            == 0
            for i in range(4, count - 4)
            for j in range(i + 1, count - 2)
        )

    assert not feasible(0.97 * bound)
    assert feasible(1.10 * bound)


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=6), st.floats(0.1, 10), st.floats(0.1, 10))
def test_an_inner_waypoint_never_shortens_a_motion(values, velocity, acceleration):
    limits = one_joint(velocity, acceleration)
    q = np.array(values)[:, None]
    assert duration_bound_s(q[[0, -1]], limits) <= duration_bound_s(q, limits) * (1 + 1e-12)
