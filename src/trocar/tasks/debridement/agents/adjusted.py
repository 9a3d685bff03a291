"""A robot whose kinematics are corrected from camera images of its grippers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import factorial

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik
from trocar.cell import Cell, JointReading, MotionEnd, MotionResult, SetPoint
from trocar.errors import ArmStopped, MotionRefused, OutOfReach, StartMismatch, TrocarError
from trocar.geometry import SE3
from trocar.tasks.debridement.agents.inverse_control import command_for, commands_for, corrected
from trocar.tasks.debridement.agents.pacing import paced
from trocar.tasks.debridement.pose import PoseEstimator
from trocar.trajectory import Trajectory

REST_STEP_S = 0.05  # the rest of a motion is sampled at this interval when it is taken over
SHORTEST_S = 1e-6  # a shorter piece of a motion is left out
LATE_S = 0.25  # nothing is corrected within this time before the end of a motion
MOST_OFF_RAD = 0.05
"""A motion that starts further than this (rad, m) from its arm's estimated joints was planned for another moment."""
INSIDE = 0.012
"""A pose counts as within reach if each joint keeps this share of its range from its ends: estimates change."""
LEAST_RATE = 0.5  # a motion that runs at less than this share of its speed is braking; it is not corrected


class StepEnded(ArmStopped):
    """An arm was stopped because it has to plan again, from a newer estimate."""

    def __init__(self, arm: str):
        super().__init__(arm, "a step of the way is done")


@dataclass(eq=False)
class Course:
    """The last motion of an arm, or the rest of it with corrected commands."""

    desired: Trajectory  # motion of the estimated joints
    commands: Trajectory  # those sent for it, on the same time
    stop_s: float | None = None  # time of the motion at which it is going to be stopped; None: at its end
    foreseen: bool = False  # whether commands were found for all of it, not only up to a stop
    successor: Course | None = None  # the corrected rest that took over, if any
    ended: trio.Event = field(default_factory=trio.Event)  # of a corrected rest
    result: MotionResult | None = None  # how that ended; None: it was refused

    def drift(self, path_s: float) -> NDArray[np.float64]:
        """Return by how much (6,) estimated joints minus commands change from the motion's start to ``path_s``."""
        first = self.commands.times_s[0]
        return (self.desired(path_s) - self.commands(path_s)) - (self.desired(first) - self.commands(first))

    def left(self, path_s: float, rate: float) -> Course | None:
        """Return the rest of the motion from ``path_s`` on, in clock time at this rate; None near its end."""
        if (float(self.desired.times_s[-1]) - path_s) / rate < LATE_S:
            return None
        stop_s = None if self.stop_s is None else (self.stop_s - path_s) / rate
        # the acceleration of a motion that uses its limits jumps; between samples, it would exceed them
        rest_of = _exact_rest_of if self.foreseen else _rest_of
        return Course(rest_of(self.desired, path_s, rate), rest_of(self.commands, path_s, rate), stop_s, self.foreseen)


def _rest_of(motion: Trajectory, path_s: float, rate: float) -> Trajectory:
    left_s = float(motion.times_s[-1]) - path_s
    times = np.linspace(path_s, motion.times_s[-1], max(2, int(np.ceil(left_s / REST_STEP_S)) + 1))
    return Trajectory.hermite((times - path_s) / rate, motion(times), rate * motion(times, 1))


def _exact_rest_of(motion: Trajectory, path_s: float, rate: float) -> Trajectory:
    """Return the rest without sampling it: the piece that has begun, from ``path_s`` on, and those after it."""
    times = motion.times_s
    after = int(np.searchsorted(times, path_s + SHORTEST_S))
    degree = len(motion.coefficients) - 1
    first = np.stack([motion(path_s, order) / factorial(order) for order in range(degree, -1, -1)])
    pieces = np.concatenate([first[:, None], motion.coefficients[:, after:]], axis=1)
    return Trajectory(np.append(path_s, times[after:]) - path_s, pieces).stretched(1 / rate)


class Adjusted:
    """A robot that works in joints as they are estimated to be, rather than as its encoders read them.

    Scripts plan in joints that a camera would confirm; commands are found by inverse control (Kehoe 2014, V-A.2): the
    commanded pose is the one at which the estimator expects the wanted pose.

    Args:
        cell: with the robot to wrap, its arms, registered bases and clock.
        estimator: makes the estimator of one arm's gripper.
    """

    def __init__(self, cell: Cell, estimator: Callable[[ArmModel], PoseEstimator]):
        self._robot, self._arms, self._limits, self._clock = cell.robot, cell.arms, cell.limits, cell.clock
        self._T_world_base = cell.T_world_base_registered
        self._estimators = {name: estimator(model) for name, model in cell.arms.items()}
        self._seen_s: dict[str, float] = {}
        self._courses: dict[str, Course] = {}
        self._off = {name: np.zeros(6) for name in cell.arms}
        self._later: dict[str, list[tuple[float, SE3, SE3]]] = {}
        self._rested: dict[str, NDArray[np.float64]] = {}
        self._braking: set[str] = set()

    def saw(self, arm: str, time_s: float, T_base_kinematic: SE3, T_world_tip: SE3) -> None:
        """Learn from the kinematic and the detected pose of the tip in an image; older images are ignored."""
        if arm in self._later:
            self._later[arm].append((time_s, T_base_kinematic, T_world_tip))
            return
        if time_s <= self._seen_s.get(arm, -np.inf):
            return
        self._estimators[arm].learn(T_base_kinematic, self._T_world_base[arm].inverse() @ T_world_tip)
        self._seen_s[arm] = time_s
        self._learn_offset(arm)

    def keep(self, arm: str) -> None:
        """Stop learning about an arm until it moves, or until ``learn``, so that a plan has a fixed estimate."""
        self._later.setdefault(arm, [])

    def learn(self, arm: str) -> None:
        """Learn from what was seen since ``keep``."""
        for sight in self._later.pop(arm, []):
            self.saw(arm, *sight)

    def age_s(self, arm: str) -> float:
        """Return the time since the image in which the arm was last seen; infinite before the first."""
        return self._clock.now_s() - self._seen_s.get(arm, -np.inf)

    def kinematic(self, arm: str) -> SE3:
        """Return ``T_base_tip`` according to the encoders now."""
        return fk(self._arms[arm], self._robot.read(arm).q)

    def T_world_tip(self, arm: str) -> SE3:
        """Return where the tip is estimated to be now."""
        return self._T_world_base[arm] @ self._estimators[arm].estimate(self.kinematic(arm))

    def reaches(self, arm: str, T_world_tip: SE3) -> bool:
        """Return whether the tip can be brought to a pose, by the estimated joints and by the commanded ones."""
        model, T_base_tip = self._arms[arm], self._T_world_base[arm].inverse() @ T_world_tip
        sent = self._robot.setpoint(arm).q
        try:
            reached = [ik(model, T_base_tip, reference=sent + self._off[arm])]
            if self._estimators[arm].foresees:
                reached.append(command_for(model, T_base_tip, self._estimators[arm].estimate, reference=sent))
        except OutOfReach:
            return False
        slack = INSIDE * (model.upper - model.lower)
        return all(((model.lower + slack < q) & (q < model.upper - slack)).all() for q in reached)

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state, with the joints as estimated."""
        reading = self._robot.read(arm)
        return replace(reading, q=reading.q + self._off[arm])

    def setpoint(self, arm: str) -> SetPoint:
        """Return the present set-point, in estimated joints."""
        sent = self._robot.setpoint(arm)
        rested = self._rested.get(arm)
        if not sent.moving and (rested is None or not np.array_equal(rested, sent.q)):
            self._learn_offset(arm)
        q = sent.q + self._off[arm] + self._drift(arm, sent)
        return replace(sent, q=np.clip(q, self._arms[arm].lower, self._arms[arm].upper))

    def expected(self, arm: str) -> Trajectory | None:
        """Return the estimated motion of the joints while the arm plays its commands, on their time."""
        course = self._courses.get(arm)
        return None if course is None else course.desired

    def course(self, arm: str) -> tuple[Trajectory, float] | None:
        """Return the estimated motion that is running and the clock at its start; None at rest."""
        sent, course = self._robot.setpoint(arm), self._courses.get(arm)
        if course is None or not sent.moving:
            return None
        return course.desired, sent.time_s - sent.path_s

    def to_stop_s(self, arm: str) -> float:
        """Return the time that an arm's motion has left until it is to be stopped; infinite if it is not."""
        sent, course = self._robot.setpoint(arm), self._courses.get(arm)
        return np.inf if course is None or course.stop_s is None else course.stop_s - sent.path_s

    def astray_m(self, arm: str) -> float:
        """Return how far the tip is estimated to be from where its motion should be now; 0 at rest."""
        sent, course = self._robot.setpoint(arm), self._courses.get(arm)
        if course is None or not sent.moving or not sent.on_path:
            return 0.0
        wanted = self._T_world_base[arm] @ fk(self._arms[arm], course.desired(sent.path_s))
        return float(np.linalg.norm(self.T_world_tip(arm).translation_m - wanted.translation_m))

    async def move(self, motions: Mapping[str, Trajectory], stop_s: float | None = None) -> Mapping[str, MotionResult]:
        """Run trajectories of the estimated joints, from rest; ``correct`` may improve the commands meanwhile.

        Args:
            motions: by arm.
            stop_s: time of the motions at which the caller is going to stop them; estimates beyond that are not used,
                unless they foresee.

        Raises:
            MotionRefused: as the robot; or a pose on the way cannot be commanded.
        """
        return await self._send(self._robot.move, motions, stop_s)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Let trajectories of the estimated joints take over from what the arms are doing now."""
        return await self._send(self._robot.replace, motions)

    async def correct(self, arm: str) -> None:
        """Let corrected commands take over for the rest of an arm's motion, if it is moving; return when it has ended.

        The motion stays as planned; what has been learned since its start changes its commands.
        """
        sent, course = self._robot.setpoint(arm), self._courses.get(arm)
        if course is None or arm in self._braking or not sent.on_path or sent.path_rate < LEAST_RATE:
            return
        left = course.left(sent.path_s, sent.path_rate)
        if left is None:
            return
        try:
            model, until_s, estimate = self._arms[arm], self._foreseen(arm, left.stop_s), self._estimators[arm].estimate
            left.commands = corrected(model, left.desired, left.commands, estimate, self._limits[arm], until_s)
            course.successor = self._courses[arm] = left
            left.result = (await self._robot.replace({arm: left.commands}))[arm]
        except MotionRefused:  # exceeds the limits: the current motion goes on
            course.successor = None
            self._courses[arm] = course
        finally:
            left.ended.set()

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Do nothing: commands are found when a motion starts, from the newest estimate."""

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws; they are not corrected by the camera."""
        return await self._robot.jaw(arm, angle_rad)

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest; nothing corrects them while they brake."""
        self._braking.update(arms or self._arms)
        self._robot.hold(*arms, reason=reason)

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        await self._robot.rest(*arms)

    def _learn_offset(self, arm: str) -> None:
        """Update the difference between the estimated and the commanded joints where the arm is now."""
        model, sent = self._arms[arm], self._robot.setpoint(arm)
        with suppress(OutOfReach):  # out of a joint's range by less than the uncertainty: keep the last offset
            T_base_tip = self._estimators[arm].estimate(fk(model, sent.q))
            self._off[arm] = ik(model, T_base_tip, reference=sent.q + self._off[arm]) - sent.q
        course = self._courses.get(arm)
        if sent.moving and course is not None:
            self._off[arm] = self._off[arm] - self._drift(arm, sent)
        self._rested[arm] = sent.q

    def _drift(self, arm: str, sent: SetPoint) -> NDArray[np.float64]:
        """Return by how much (6,) the offset has changed since the start of the arm's motion."""
        course = self._courses.get(arm)
        if course is None or not sent.moving or not sent.on_path:
            return np.zeros(6)
        return course.drift(sent.path_s)

    async def _send(
        self, verb: Callable[[Mapping[str, Trajectory]], Awaitable[Mapping[str, MotionResult]]],
        motions: Mapping[str, Trajectory], stop_s: float | None = None,
    ) -> Mapping[str, MotionResult]:  # fmt: skip
        courses = {arm: self._course(arm, motion, stop_s) for arm, motion in motions.items()}
        before = {arm: self._courses[arm] for arm in motions if arm in self._courses}
        self._courses |= courses
        self._braking.difference_update(motions)
        for arm in motions:
            self.learn(arm)
        try:
            results = await verb({arm: course.commands for arm, course in courses.items()})
            return {arm: await self._last(arm, results[arm], course) for arm, course in courses.items()}
        except MotionRefused:  # the current motion goes on
            self._courses = {arm: course for arm, course in self._courses.items() if arm not in motions} | before
            raise

    async def _last(self, arm: str, result: MotionResult, course: Course) -> MotionResult:
        """Return how a motion ended, with its own commands or corrected ones."""
        while result.ended is MotionEnd.REPLACED and course.successor is not None:
            course = course.successor
            try:
                await course.ended.wait()
            except trio.Cancelled:  # the robot brakes only if ``correct``, which waits for it, is cancelled
                self.hold(arm, reason="nobody waits for the motion any more")
                raise
            if course.result is None:
                break
            result = course.result
        return result

    def _course(self, arm: str, desired: Trajectory, stop_s: float | None) -> Course:
        current = self.setpoint(arm).q
        off = float(np.abs(desired(desired.times_s[0]) - current).max())
        if off > MOST_OFF_RAD:
            problem = f"starts {off:.4f} rad (or m) away from where it is estimated to be"
            raise StartMismatch(arm, problem, "plan it from its set-point")
        sent, estimate, until_s = self._robot.setpoint(arm), self._estimators[arm].estimate, self._foreseen(arm, stop_s)
        model = self._arms[arm]
        commands = commands_for(model, desired, estimate, q_start=sent.q, velocity=sent.velocity, until_s=until_s)
        if until_s is None and not sent.moving:
            desired, commands, times = paced(model, desired, commands, self._limits[arm])
            stop_s = None if stop_s is None else float(np.interp(stop_s, *times.T))
        return Course(desired, commands, stop_s, until_s is None)

    def _foreseen(self, arm: str, stop_s: float | None) -> float | None:
        """Return the time of a motion up to which the estimator is used; None: it foresees, so to the end."""
        return None if self._estimators[arm].foresees else np.inf if stop_s is None else stop_s
