"""A robot whose motions a person permits, stops and lets go on."""

import itertools

import numpy as np
import pytest
import trio

from driven import ARM, HOME, PAPER, PlainArms
from trocar.cell import MotionEnd
from trocar.errors import TooNear
from trocar.motion import rest_to_rest
from trocar.robots import TICK_S, ArmGuard, Guarded
from trocar.robots.supervised import StoppedByPerson, Supervised

GOAL = HOME + np.array([0.4, 0.3, -0.05, 0.8, 0.5, -0.6])
MOTION = rest_to_rest(HOME, GOAL, PAPER).stretched(1.5)
STOP_S, STAY_S = MOTION.duration_s / 2, 0.5


class Switch:
    """A person who stops the arm at times, and lets it go on later."""

    def __init__(self):
        self.stopped, self.asked = False, 0

    async def permit(self, motions, *, begun=False):
        self.begun = begun
        self.asked += 1
        await self.free(*motions)

    async def free(self, arm):
        while self.stopped:
            await trio.sleep(TICK_S)

    def forbids(self, arm):
        return self.stopped


def supervised(stops=()):
    """Return arms that are stopped at these times for ``STAY_S`` each, and the switch that does it."""
    arms, switch = PlainArms(), Switch()
    guard = Guarded(arms.driver, {"a": ArmGuard(ARM, PAPER)})
    arms.robot = Supervised(guard, switch)
    arms.each_tick.append(guard.check)

    def act():
        now_s = arms.now_s()
        before, switch.stopped = switch.stopped, any(at <= now_s < at + STAY_S for at in stops)
        if switch.stopped and not before:
            guard.hold(reason=StoppedByPerson("a"))

    act()
    arms.each_tick.append(act)
    return arms, switch


@pytest.mark.parametrize("stops", [(STOP_S,), (0.05, 0.9), (STOP_S, STOP_S + 0.55), (MOTION.duration_s - 0.02,)])
def test_a_motion_that_is_stopped_goes_on_along_its_path(stops):
    arms, _ = supervised(stops)
    seen = []
    arms.each_tick.append(lambda: seen.append(arms.robot.setpoint("a")))
    result = arms.run(lambda: arms.robot.move({"a": MOTION}))["a"]
    assert result.done and result.cause is None
    np.testing.assert_allclose(arms.sent["a"][-1], GOAL, atol=1e-9)
    assert np.all(np.diff([one.path_s for one in seen]) >= -1e-9)
    for one in seen:
        np.testing.assert_allclose(one.q, MOTION(one.path_s), atol=2e-4)
    for before, after in itertools.pairwise(seen):  # its time runs on from where it was stopped
        low, high = sorted((before.path_rate, after.path_rate))
        assert low - 0.1 <= (after.path_s - before.path_s) / TICK_S <= high + 0.1
    assert max(arms.use("a")) <= 1.001
    assert len(result.times_s) == len(result.commanded) and np.all(np.diff(result.times_s) > 0)
    assert arms.now_s() > MOTION.duration_s + STAY_S - 0.2


def test_without_a_person_nothing_changes():
    arms, switch = supervised()
    plain = PlainArms()
    arms.run(lambda: arms.robot.move({"a": MOTION}))
    plain.run(lambda: plain.robot.move({"a": MOTION}))
    np.testing.assert_array_equal(arms.sent["a"], plain.sent["a"])
    assert switch.asked == 1


def test_a_motion_that_is_not_permitted_waits():
    arms, _ = supervised([0.0])
    arms.run(lambda: arms.robot.move({"a": MOTION}))
    assert arms.now_s() == pytest.approx(STAY_S + MOTION.duration_s, abs=0.05)


def test_a_stream_is_not_waited_for():
    arms, switch = supervised()
    switch.stopped = True

    async def script():
        return await arms.robot.replace({"a": MOTION})

    arms.each_tick.clear()
    result = arms.run(script)["a"]
    assert result.ended is MotionEnd.HELD and isinstance(result.cause, StoppedByPerson)
    np.testing.assert_array_equal(arms.sent["a"][-1], HOME)


def test_jaws_that_are_stopped_go_on():
    arms, _ = supervised([0.05])
    result = arms.run(lambda: arms.robot.jaw("a", 1.0))
    assert result.done and arms.driver.jaw_command_rad("a") == pytest.approx(1.0) and arms.now_s() > 0.05 + STAY_S


@pytest.mark.parametrize("refusals", [1, 2])
def test_a_motion_whose_rest_is_refused_tries_again_and_then_has_ended_where_it_was_stopped(refusals, monkeypatch):
    arms, _ = supervised([STOP_S])
    near = TooNear("in the way", first="a", second="b", distance_m=0.0, required_m=1e-3, arms=("a", "b"))
    guard, left = arms.robot.robot, [near] * refusals
    move = guard.move

    async def refusing(motions):
        if left and arms.now_s() > STOP_S:
            raise left.pop()
        return await move(motions)

    monkeypatch.setattr(guard, "move", refusing)
    result = arms.run(lambda: arms.robot.move({"a": MOTION}))["a"]
    now = arms.robot.setpoint("a")
    np.testing.assert_allclose(now.q, MOTION(now.path_s), atol=2e-4)
    if refusals == 1:
        assert result.done and now.path_s == pytest.approx(MOTION.duration_s)
    else:
        assert result.ended is MotionEnd.HELD and isinstance(result.cause, TooNear)
        assert STOP_S < now.path_s < MOTION.duration_s - 0.1


def test_jaws_wait_until_the_arm_may_be_used():
    arms, _ = supervised([0.0])

    async def script():
        await arms.robot.jaw("a", 0.5)
        return arms.now_s()

    assert arms.run(script) >= STAY_S
    assert arms.robot.jaws_rad == {"a": 0.5}
