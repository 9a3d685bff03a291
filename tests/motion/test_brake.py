"""Coming to rest on a path: never harder than the limits allow, and hardly slower."""

import numpy as np
import pytest

from trocar.arms import MotionLimits
from trocar.motion import rest_to_rest
from trocar.motion.brake import Brake, _least_push, brake
from trocar.trajectory import Trajectory

FAR = np.full(2, 1e3)


def limits(velocity=1e3, acceleration=2.0, joints=2):
    return MotionLimits(np.full(joints, velocity), np.full(joints, acceleration))


def test_between_two_steps_the_rate_is_linear_and_the_path_quadratic():
    stop = Brake(np.array([0.0, 1.0, 3.0]), np.array([5.0, 5.75, 6.25]), np.array([1.0, 0.5, 0.0]))
    assert stop.duration_s == 3.0
    path, rate = stop.at(np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0]))
    np.testing.assert_allclose(rate, [1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0])
    np.testing.assert_allclose(path, [5.0, 5.0, 5.4375, 5.75, 6.125, 6.25, 6.25])


def test_the_joint_that_can_brake_least_decides():
    velocity, acceleration, reach = np.array([[1.0, -2.0]]), np.array([[0.5, 0.25]]), np.array([1.0, 1.0])
    # v s'' + a rate^2 >= -1 for the first one, <= 1 for the second one, which goes backwards
    assert _least_push(velocity, acceleration, reach, 1.0) == pytest.approx(-0.375)
    assert _least_push(velocity, acceleration, reach, 0.5) == pytest.approx(-0.46875)
    assert _least_push(velocity[:, :1], acceleration[:, :1], reach[:1], 1.0) == pytest.approx(-1.5)
    assert _least_push(0 * velocity, acceleration, reach, 1.0) == -1000.0  # nothing moves: within a step
    assert _least_push(velocity * [1, 0], 0 * acceleration, reach, 1.0) == pytest.approx(-1.0)
    assert _least_push(velocity, -4 * acceleration, reach, 1.0) == 0.0  # brakes already with more than it may
    ends = np.array([[1.0, 0.0], [4.0, 0.0]])
    assert _least_push(ends, 0 * ends, reach, 1.0) == pytest.approx(-0.25)


@pytest.mark.parametrize(("speed", "acceleration"), [(0.5, 2.0), (0.5, 1.0), (0.2, 2.0)])
def test_an_even_motion_stops_with_all_that_braking_may_use(speed, acceleration):
    """In v / a and v^2 / 2a, the slower joint in step."""
    motion = Trajectory(np.array([0.0, 10.0]), np.array([[speed, -speed / 2], [0.1, 0.2]])[:, None])
    stop = brake(motion, 3.0, limits(acceleration=acceleration), -FAR, FAR)
    most = 0.99 * acceleration
    assert stop.off_path is None
    assert stop.duration_s == pytest.approx(speed / most, rel=1e-9)
    assert stop.path_s[0] == 3.0
    assert stop.path_s[-1] == pytest.approx(3.0 + speed / most / 2, rel=1e-9)
    assert stop.rate[0] == 1.0 and stop.rate[-1] == 0.0
    steps = np.diff(stop.times_s)
    assert steps[:-1].max() <= 1e-3 + 1e-12
    assert np.abs(np.diff(stop.rate)).max() <= 0.02 + 1e-9


def test_an_end_that_comes_first_is_the_end():
    motion = Trajectory(np.array([0.0, 1.0]), np.array([[0.5, 0.5], [0.0, 0.0]])[:, None])
    stop = brake(motion, 0.9, limits(), -FAR, FAR)
    assert stop.path_s[-1] == 1.0 and stop.rate[-1] == 0.0
    assert 0.1 < stop.duration_s < 0.2
    at_end = brake(motion, 1.0, limits(), -FAR, FAR)
    assert at_end.duration_s == 0.0 and at_end.rate.tolist() == [0.0]


@pytest.mark.parametrize(("seed", "share"), [(0, 0.05), (0, 0.3), (1, 0.45), (2, 0.35), (3, 0.4)])
def test_braking_keeps_the_limits_at_every_step_and_hardly_leaves_any_room(seed, share):
    rng = np.random.default_rng(seed)
    bounds = MotionLimits(rng.uniform(0.3, 1.0, 6), rng.uniform(1.0, 4.0, 6))
    motion = rest_to_rest(rng.uniform(-0.3, 0.3, 6), rng.uniform(-0.3, 0.3, 6), bounds)
    stop = brake(motion, share * motion.duration_s, bounds, np.full(6, -9.0), np.full(6, 9.0))
    assert stop.off_path is None
    seconds, rate = np.diff(stop.times_s), stop.rate
    assert np.all(seconds > 0) and seconds.max() <= 1e-3 + 1e-12
    assert np.all(np.diff(rate) <= 0) and np.diff(rate)[:-1].min(initial=0.0) >= -0.02 - 1e-9
    np.testing.assert_allclose(np.diff(stop.path_s), seconds * (rate[1:] + rate[:-1]) / 2, atol=1e-12)
    push, s, r = (np.diff(rate) / seconds)[:, None], stop.path_s[:-1], rate[:-1, None]
    used = (np.abs(motion(s, 1) * push + motion(s, 2) * r**2) / bounds.acceleration).max(axis=1)
    assert used[:-1].max() <= 0.99 + 1e-9
    assert used[:-2].mean() > 0.95


def test_an_arm_that_has_just_set_out_stops_within_its_limits():
    """Two milliseconds after the start its time can be stopped at once; the steps are then short."""
    bounds = limits(acceleration=2.0)
    motion = rest_to_rest(np.zeros(2), np.array([0.5, 0.2]), bounds)
    stop = brake(motion, 0.002, bounds, -FAR, FAR)
    assert 0.0019 < stop.duration_s < 0.0025  # v / (.99 a), from v = a t
    assert np.diff(stop.times_s)[:-1].min() >= 5e-5 - 1e-12
    assert len(stop.rate) > 20
    when = np.linspace(0, stop.duration_s, 1001)
    place, rate = stop.at(when)
    speed = motion(place, 1) * rate[:, None]
    assert np.abs(np.diff(speed, axis=0)).max() / (when[1] - when[0]) <= 2.0 * (1 + 0.02)


SWING_S = 0.1


def sawteeth(count=5, speed=0.5, push=8.0):
    """Two joints that by turns slow down and speed up with all they have: one of them always brakes already."""
    coefficients, v = np.zeros((3, count, 2)), np.array([speed + push * SWING_S / 2, speed - push * SWING_S / 2])
    q = np.zeros(2)
    for k in range(count):
        a = np.array([-push, push]) * (-1) ** k
        coefficients[:, k] = a / 2, v, q
        q = q + v * SWING_S + a * SWING_S**2 / 2
        v = v + a * SWING_S
    return Trajectory(SWING_S * np.arange(count + 1), coefficients)


def test_where_the_path_cannot_be_left_slowly_the_joints_stop_by_themselves():
    motion, bounds = sawteeth(), limits(acceleration=8.0)
    velocity, q = motion(0.0, 1), motion(0.0)
    alone_s = velocity.max() / (0.99 * 8.0)
    stop = brake(motion, 0.0, bounds, -FAR, FAR)
    assert stop.off_path is not None
    assert stop.duration_s == pytest.approx(alone_s)
    np.testing.assert_array_equal(stop.path_s, [0.0, 0.0])
    np.testing.assert_array_equal(stop.rate, [0.0, 0.0])
    np.testing.assert_allclose(stop.off_path(0.0), q)
    np.testing.assert_allclose(stop.off_path(0.0, 1), velocity)
    np.testing.assert_allclose(stop.off_path(np.nextafter(alone_s, 0), 1), 0, atol=1e-9)
    np.testing.assert_allclose(stop.off_path(alone_s), q + velocity * alone_s / 2)
    assert np.abs(stop.off_path(0.0, 2)).max() == pytest.approx(0.99 * 8.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_path_is_kept_where_a_range_ends_or_it_hardly_takes_longer(sign):
    motion, bounds = sawteeth(), limits(acceleration=8.0)
    motion = Trajectory(motion.times_s, sign * motion.coefficients)
    velocity = motion(0.0, 1)
    alone_s = np.abs(velocity).max() / (0.99 * 8.0)
    end = motion(0.0) + velocity * alone_s / 2
    for room, leaves in ((1e-9, True), (-1e-9, False)):
        for joint in range(2):
            bound = sign * FAR
            bound[joint] = end[joint] + sign * room
            lower, upper = (-FAR, bound) if sign > 0 else (bound, FAR)
            assert (brake(motion, 0.0, bounds, lower, upper).off_path is not None) == leaves
    patience_s = 2 * alone_s + 0.1
    for longer_s, leaves in ((5e-3, True), (-5e-3, False)):
        whole_s = patience_s + longer_s
        knots = np.append(motion.times_s[motion.times_s < whole_s - 1e-9], whole_s)
        short = Trajectory(knots, motion.coefficients[:, : len(knots) - 1])
        assert (brake(short, 0.0, bounds, -FAR, FAR).off_path is not None) == leaves
