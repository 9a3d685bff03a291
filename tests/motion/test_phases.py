"""Phases of constant acceleration of one joint, against cases that can be computed by hand."""

import numpy as np
import pytest

from trocar.motion.phases import joined, phases_to_rest

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
