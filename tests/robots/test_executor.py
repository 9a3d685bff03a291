"""The set-points of one arm: while it rests, moves, brakes on its path or off it, and when it is asked twice."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from driven import ARM, GOAL, HOME, PAPER
from trocar.cell import MotionEnd
from trocar.errors import ArmStopped
from trocar.motion import rest_to_rest
from trocar.robots.executor import Ending, TrajectoryExecutor
from trocar.trajectory import Trajectory

START_S = 2.0
HELD = Ending(MotionEnd.HELD, ArmStopped("a", "somebody is in the way"))
FAULT = Ending(MotionEnd.FAULT, ArmStopped("a", "a wrapper"))
ONE_AFTER_THE_OTHER = np.array([[1, 1, 0, 1, 0, 0], [0, 1, 0, 1, 0, 0], [0, 0, 0, 1, 0, 0], np.zeros(6)])
"""Which joints still run at each knot."""


def there():
    """A motion whose own time begins at 7 s."""
    motion = rest_to_rest(HOME, GOAL, PAPER)
    return Trajectory(motion.times_s + 7.0, motion.coefficients)


def slow_to_stop():
    """Yaw, pitch and roll brake one after the other as hard as they may: on its path it cannot stop sooner."""
    velocity = 0.25 * 0.999 * PAPER.acceleration * ONE_AFTER_THE_OTHER
    q = HOME + np.concatenate([np.zeros((1, 6)), np.cumsum(0.125 * (velocity[1:] + velocity[:-1]), axis=0)])
    return Trajectory.hermite(7.0 + 0.25 * np.arange(4), q, velocity)


def executing(motion):
    executor = TrajectoryExecutor(ARM, PAPER, HOME)
    executor.start(motion, START_S)
    return executor


def test_at_rest_it_is_where_it_was_put():
    executor = TrajectoryExecutor(ARM, PAPER, HOME)
    now = executor.now(START_S)
    assert (now.time_s, now.moving, now.path_s, now.path_rate, now.on_path) == (START_S, False, 0.0, 0.0, True)
    assert_array_equal(now.q, HOME)
    q, velocity = executor.samples(START_S + np.arange(3.0))
    assert_array_equal(q, [HOME] * 3)
    assert velocity.shape == (3, 6) and not velocity.any()
    executor.brake(START_S, HELD)
    assert not executor.moving and not executor.braking
    assert executor.remaining(START_S, 0.01) is None and executor.advance(START_S + 100.0) is None


def test_a_motion_runs_on_the_cells_clock_from_its_beginning():
    motion = there()
    executor = executing(motion)
    for since_s in (0.0, 0.1, 0.37 * motion.duration_s):
        now = executor.now(START_S + since_s)
        assert_allclose(now.q, motion(7.0 + since_s), atol=1e-12)
        assert_allclose(now.velocity, motion(7.0 + since_s, 1), atol=1e-9)
        assert (now.moving, now.path_rate, now.on_path) == (True, 1.0, True)
        assert now.path_s == pytest.approx(since_s)
    q, velocity = executor.samples(np.array([START_S + 0.1, START_S + 0.2]))
    assert_allclose(q, motion([7.1, 7.2]), atol=1e-12)
    assert_allclose(velocity, motion([7.1, 7.2], 1), atol=1e-9)
    assert executor.remaining(START_S + 0.1, 0.01) == (motion, START_S)
    assert executor.moving and not executor.braking


def test_it_ends_a_microsecond_before_its_time_and_not_sooner():
    """Durations are sums of floats."""
    motion = there()
    executor = executing(motion)
    end_s = START_S + motion.duration_s
    assert executor.now(end_s - 1.5e-6).path_rate == 1.0
    assert executor.now(end_s - 0.5e-6).path_rate == 0.0
    assert executor.advance(end_s - 1.5e-6) is None and executor.moving
    late = executor.now(end_s + 0.1)
    assert late.path_s == pytest.approx(motion.duration_s) and not late.velocity.any()
    assert_allclose(late.q, GOAL, atol=1e-12)
    assert executor.advance(end_s - 0.5e-6) == Ending()
    rest = executor.now(end_s + 0.1)
    assert not rest.moving and not rest.velocity.any() and rest.path_rate == 0.0 and rest.on_path
    assert rest.path_s == pytest.approx(motion.duration_s)
    assert_allclose(rest.q, GOAL, atol=1e-12)


@pytest.mark.parametrize("step_s", [0.01, 0.007])
def test_braking_keeps_the_path_and_what_remains_of_it_can_be_told(step_s):
    motion = there()
    executor = executing(motion)
    held_s = START_S + 0.4 * motion.duration_s
    executor.brake(held_s, HELD)
    executor.brake(held_s + 0.01, FAULT)
    assert executor.braking
    now = executor.now(held_s)
    assert now.path_rate == 1.0 and now.path_s == pytest.approx(0.4 * motion.duration_s)
    assert_allclose(now.q, motion(7.0 + now.path_s), atol=1e-12)
    trajectory, begin_s = executor.remaining(held_s + 0.02, step_s)
    assert begin_s == held_s + 0.02
    assert trajectory.times_s[0] == 0.0 and np.ptp(np.diff(trajectory.times_s)) < 1e-9
    assert_allclose(np.diff(trajectory.times_s)[0], step_s)
    for since_s in trajectory.times_s:
        then = executor.now(begin_s + since_s)
        assert_allclose(trajectory(since_s), then.q, atol=1e-9)
        assert_allclose(trajectory(since_s, 1), then.velocity, atol=1e-6)
        assert_allclose(then.q, motion(7.0 + then.path_s), atol=1e-9)
        assert_allclose(then.velocity, then.path_rate * motion(7.0 + then.path_s, 1), atol=1e-9)
    end_s = begin_s + trajectory.duration_s
    assert executor.now(end_s).path_rate == 0.0 < executor.now(end_s - step_s).path_rate, "to its end and no further"
    assert executor.advance(end_s - step_s) is None
    assert executor.advance(end_s) == HELD
    rest = executor.now(end_s)
    assert not rest.moving and not rest.velocity.any()
    assert rest.path_s == pytest.approx(then.path_s) and rest.path_s < motion.duration_s
    assert_allclose(rest.q, motion(7.0 + rest.path_s), atol=1e-12)


def test_what_remains_lasts_a_step_at_least():
    motion = there()
    executor = executing(motion)
    executor.brake(START_S + 0.1, HELD)
    trajectory, begin_s = executor.remaining(START_S + 10.0, 0.01)
    assert (begin_s, trajectory.duration_s) == (START_S + 10.0, pytest.approx(0.01))
    assert_allclose(trajectory.q[1], trajectory.q[0])


def test_told_to_brake_when_it_should_have_ended_it_is_at_its_end():
    motion = there()
    executor = executing(motion)
    late_s = START_S + motion.duration_s + 0.005
    executor.brake(late_s, HELD)
    assert_allclose(executor.now(late_s).q, GOAL, atol=1e-9)
    assert executor.advance(late_s) == HELD


def test_off_its_path_it_stops_as_its_joints_do_and_says_so_at_once():
    """What was told in this tick before it was braked is told no longer."""
    motion = slow_to_stop()
    executor = executing(motion)
    held_s = START_S + 0.02
    before = executor.now(held_s)
    assert before.on_path
    executor.brake(held_s, FAULT)
    at = executor.now(held_s)
    assert not at.on_path and at.moving and at.path_rate == 0.0
    assert_allclose(at.q, before.q)
    assert_allclose(at.velocity, before.velocity)
    alone_s = np.max(np.abs(at.velocity) / PAPER.acceleration)
    trajectory, _ = executor.remaining(held_s, 0.01)
    assert alone_s < trajectory.duration_s < 1.1 * alone_s + 0.01
    ends = at.q + 0.5 * alone_s * at.velocity
    assert executor.advance(held_s + 1.1 * alone_s) == FAULT
    rest = executor.now(held_s + 1.1 * alone_s)
    assert_allclose(rest.q, ends, atol=0.02 * np.abs(ends - at.q).max())
    assert not rest.on_path and not rest.moving and rest.path_s == pytest.approx(before.path_s)
    executor.start(rest_to_rest(rest.q, HOME, PAPER), 5.0)
    assert executor.now(5.0).on_path, "the next motion has a path again"


def test_whatever_changes_the_motion_is_told_in_the_same_tick():
    motion = there()
    executor = TrajectoryExecutor(ARM, PAPER, HOME)
    assert not executor.now(START_S).moving
    executor.start(motion, START_S)
    assert executor.now(START_S).moving
    half_s = START_S + 0.5 * motion.duration_s
    moving = executor.now(half_s)
    assert executor.now(half_s) is moving, "all who ask in one tick get the same"
    for values in (moving.q, moving.velocity):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0
    executor.freeze(half_s)
    frozen = executor.now(half_s)
    assert not frozen.moving and not frozen.velocity.any() and frozen.path_rate == 0.0
    assert frozen.path_s == moving.path_s
    assert_array_equal(frozen.q, moving.q)
    executor.start(rest_to_rest(frozen.q, HOME, PAPER), half_s)
    done_s = half_s + 10.0
    assert executor.now(done_s).moving
    assert executor.advance(done_s) == Ending()
    assert not executor.now(done_s).moving
