"""A robot corrected from camera images: what it corrects, and what it leaves alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trio
import trio.testing

from trocar.arms import MotionLimits, fk
from trocar.cell import JointReading, MotionEnd, MotionResult, SetPoint
from trocar.errors import OutOfReach, TooNear
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.motion import limit_use, rest_to_rest
from trocar.tasks.debridement.agents.adjusted import Adjusted
from trocar.tasks.debridement.agents.inverse_control import command_for
from trocar.tasks.debridement.pose import PaperAdjustment

LEFT = load_station("raven-pair").arms["left"]
ARM, START = LEFT.model, LEFT.park_q()
LIMITS = MotionLimits(0.3 * ARM.motion_limits.velocity, 0.3 * ARM.motion_limits.acceleration)
MOTION = rest_to_rest(START, START + [0.05, 0.05, -0.02, 0.1, 0.0, 0.0], LIMITS)
OFF = np.array([0.004, 0.0, -0.003])
"""Where the tip is seen beside where the kinematics have it; so little that a correction fits into the limits."""


class Held:
    """An estimator that adds the last shift that was seen."""

    foresees = True

    def __init__(self):
        self.shift_m = np.zeros(3)

    def learn(self, T_base_kinematic, T_base_detected):
        self.shift_m = T_base_detected.translation_m - T_base_kinematic.translation_m

    def estimate(self, T_base_kinematic):
        return SE3.from_parts(T_base_kinematic.rotation, T_base_kinematic.translation_m + self.shift_m)


class FakeRobot:
    """A robot that is in the middle of whatever it was told."""

    def __init__(self):
        self.sent, self.replaced, self.held, self.rate = None, [], [], 1.0
        self.over = trio.Event()

    def at(self):
        motion, half = self.sent, 0.5 * self.sent.duration_s
        return SetPoint(1.0, motion(half), motion(half, 1), True, half, self.rate, True)

    def setpoint(self, arm):
        del arm
        return SetPoint(0.0, START, np.zeros(6), False, 0.0, 0.0, True) if self.sent is None else self.at()

    def read(self, arm):
        return JointReading(1.0, self.setpoint(arm).q, 0.5)

    async def move(self, motions):
        (self.sent,) = motions.values()
        await self.over.wait()
        ended = MotionEnd.REPLACED if self.replaced else MotionEnd.DONE
        return {"left": MotionResult(np.zeros(0), np.zeros((0, 7)), np.zeros((0, 7)), ended)}

    async def replace(self, motions):
        self.replaced.append(motions["left"])
        self.over.set()
        await trio.sleep_forever()

    def hold(self, *arms, reason=""):
        self.held.append((arms, reason))


def adjusted(estimator=Held):
    robot = FakeRobot()
    cell = SimpleNamespace(
        robot=robot,
        arms={"left": ARM},
        limits={"left": ARM.motion_limits},
        T_world_base_registered={"left": LEFT.T_world_base},
        clock=SimpleNamespace(now_s=lambda: 1.0),
    )
    return Adjusted(cell, lambda _: estimator()), robot  # type: ignore[arg-type]


async def under_way(nursery, motion=MOTION):
    """Return a robot that moves and has just been seen beside its way, and the robot under it."""
    wrapped, robot = adjusted()
    nursery.start_soon(wrapped.move, {"left": motion})
    await trio.testing.wait_all_tasks_blocked()
    kinematic = wrapped.kinematic("left")
    seen = LEFT.T_world_base @ SE3.from_parts(kinematic.rotation, kinematic.translation_m + OFF)
    wrapped.saw("left", 1.0, kinematic, seen)
    return wrapped, robot


async def tried(prepare, motion=MOTION):
    """Return the robot after ``prepare`` and a correction."""
    async with trio.open_nursery() as nursery:
        wrapped, robot = await under_way(nursery, motion)
        prepare(wrapped, robot)
        with trio.move_on_after(0.1):
            await wrapped.correct("left")
        nursery.cancel_scope.cancel()
    return robot


def test_a_motion_under_way_is_corrected_by_what_is_seen():
    robot = trio.run(tried, lambda wrapped, robot: None)
    (commands,) = robot.replaced
    ends = [fk(ARM, motion(motion.times_s[-1])).translation_m for motion in (commands, MOTION)]
    np.testing.assert_allclose(ends[0] - ends[1], -OFF, atol=3e-4)


def test_a_motion_that_nearly_uses_the_limits_is_corrected_too():
    """Its acceleration jumps; were its rest sampled anew, it would exceed the limits between the samples."""
    limits = MotionLimits(0.15 * ARM.motion_limits.velocity, 0.88 * ARM.motion_limits.acceleration)
    fast = rest_to_rest(START, START + [0.5, 0.1, -0.02, 0.2, -0.3, 0.2], limits)
    robot = trio.run(tried, lambda wrapped, robot: None, fast)
    (commands,) = robot.replaced
    assert limit_use(ARM, commands, ARM.motion_limits).acceleration_ratio < 0.98
    moved = np.subtract(*(fk(ARM, motion(motion.times_s[-1])).translation_m for motion in (commands, fast)))
    np.testing.assert_allclose(moved / np.linalg.norm(moved), -OFF / np.linalg.norm(OFF), atol=0.05)
    assert np.linalg.norm(moved) > 1e-3, "as much as fits into the limits"


@pytest.mark.parametrize(
    "braking",
    [lambda wrapped, robot: wrapped.hold("left", reason="enough"), lambda _, robot: setattr(robot, "rate", 0.1)],
)
def test_an_arm_that_is_braking_is_not_set_in_motion_again_by_a_correction(braking):
    assert trio.run(tried, braking).replaced == []


def test_a_motion_that_is_refused_leaves_the_one_before_it():
    async def refused(motions):
        raise TooNear("left", arms=("left",), first="left", second="table", distance_m=0.0, required_m=1e-3)

    async def tried_in_vain():
        resting, robot = adjusted()
        robot.move = refused
        with pytest.raises(TooNear):
            await resting.move({"left": MOTION})
        async with trio.open_nursery() as nursery:
            wrapped, robot = await under_way(nursery)
            robot.replace = refused
            here = wrapped.setpoint("left").q
            with pytest.raises(TooNear):
                await wrapped.replace({"left": rest_to_rest(here, here + 0.02, LIMITS)})
            nursery.cancel_scope.cancel()
        return resting.expected("left"), wrapped.expected("left")

    assert trio.run(tried_in_vain) == (None, MOTION)


def test_it_says_how_far_the_tip_is_from_its_way():
    async def measured():
        async with trio.open_nursery() as nursery:
            wrapped, _ = await under_way(nursery)
            found = wrapped.astray_m("left")
            nursery.cancel_scope.cancel()
            return found

    assert trio.run(measured) == pytest.approx(np.linalg.norm(OFF), abs=1e-4)


def test_whoever_gives_up_a_corrected_motion_stops_the_arm():
    async def given_up():
        wrapped, robot = adjusted()
        async with trio.open_nursery() as nursery:
            with trio.CancelScope() as script:

                async def correct():
                    await trio.testing.wait_all_tasks_blocked()
                    nursery.start_soon(wrapped.correct, "left")
                    await trio.testing.wait_all_tasks_blocked()
                    script.cancel()

                nursery.start_soon(correct)
                await wrapped.move({"left": MOTION})
            held = list(robot.held)
            nursery.cancel_scope.cancel()
        return robot, held

    robot, held = trio.run(given_up)
    assert len(robot.replaced) == 1
    assert [arms for arms, _ in held] == [("left",)]


def test_a_motion_that_is_corrected_is_still_stopped_where_it_was_to_be():
    stop_s = 0.8 * MOTION.duration_s

    async def left():
        async with trio.open_nursery() as nursery:
            wrapped, robot = adjusted()
            nursery.start_soon(wrapped.move, {"left": MOTION}, stop_s)
            await trio.testing.wait_all_tasks_blocked()
            before = wrapped.to_stop_s("left")
            nursery.start_soon(wrapped.correct, "left")
            await trio.testing.wait_all_tasks_blocked()
            robot.sent, half = robot.replaced[0], 0.5 * robot.replaced[0].duration_s
            after = wrapped.to_stop_s("left") + half  # the robot says that half of what it was sent last is over
            nursery.cancel_scope.cancel()
        return before, after

    before, after = trio.run(left)
    assert before == pytest.approx(0.3 * MOTION.duration_s)
    assert after == pytest.approx(before)


def test_an_estimator_that_does_not_foresee_is_not_asked_what_is_within_reach():
    wrapped, _ = adjusted(PaperAdjustment)
    # seen turned by half a radian: the rule turns the way to a place far off, and would command it out of range
    for time_s, ahead in ((0.2, 0.0), (0.4, 0.001)):
        kinematic = wrapped.kinematic("left") @ SE3.from_parts(translation_m=(ahead, 0.0, 0.0))
        turned = SE3.from_parts(kinematic.rotation @ SO3.axis("z", 0.5), kinematic.translation_m)
        wrapped.saw("left", time_s, kinematic, LEFT.T_world_base @ turned)
    far = START.copy()
    far[2] = ARM.upper[2] - 0.01
    believed = wrapped.read("left").q
    assert wrapped.reaches("left", LEFT.T_world_base @ fk(ARM, np.append(far[:3], believed[3:])))
    with pytest.raises(OutOfReach):
        command_for(ARM, fk(ARM, np.append(far[:3], believed[3:])), wrapped._estimators["left"].estimate, START)


@pytest.mark.parametrize("stopped", [False, True])
def test_joints_on_the_way_are_estimated_where_the_estimator_expects_the_tip(stopped):
    """Their offset changes along a motion, here by up to .09 rad; where it was stopped, it is learned anew."""

    async def halfway():
        wrapped, robot = adjusted()
        kinematic = wrapped.kinematic("left")
        seen = SE3.from_parts(kinematic.rotation, kinematic.translation_m + 5 * OFF)
        wrapped.saw("left", 1.0, kinematic, LEFT.T_world_base @ seen)
        start = wrapped.setpoint("left").q
        async with trio.open_nursery() as nursery:
            motion = rest_to_rest(start, start + [0.4, 0.3, -0.05, 0.5, 0, 0], LIMITS)
            nursery.start_soon(wrapped.move, {"left": motion})
            await trio.testing.wait_all_tasks_blocked()
            there = robot.setpoint("left")
            if stopped:
                robot.setpoint = lambda _: replace(there, moving=False)
            places = [fk(ARM, one.setpoint("left").q).translation_m for one in (wrapped, robot)]
            nursery.cancel_scope.cancel()
        return places

    estimated, sent = trio.run(halfway)
    np.testing.assert_allclose(estimated - sent, 5 * OFF, atol=1e-4)
