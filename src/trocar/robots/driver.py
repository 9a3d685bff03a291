"""Several arms on one clock behind the ``Robot`` protocol, for any controller that takes set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import trio

from trocar.arms import ArmModel, MotionLimits
from trocar.cell import JointReading, MotionEnd, MotionResult, SetPoint
from trocar.errors import ArmMoving, ArmStopped, TrocarError, UnknownName
from trocar.geometry.arrays import Array, appended
from trocar.robots.executor import Ending, TrajectoryExecutor
from trocar.trajectory import Trajectory

TICK_S = 0.010
"""Period of the arms' controller (Hwang et al. 2022, V-B: 10 ms)."""

JAW_REST_S = 0.05
"""Settling time of the jaws after the end of their ramp."""


@dataclass
class Completion:
    """How a motion of an arm or its jaws ended, and the row after its last one, for the script that waits for it."""

    ending: Ending = Ending()
    last: int = 0
    over: trio.Event = field(default_factory=trio.Event)

    def finish(self, ending: Ending, last: int) -> None:
        """Wake the script that waits; only the first ending counts."""
        if not self.over.is_set():
            self.ending, self.last = ending, last
            self.over.set()


@dataclass
class _Jaw:
    """Jaws that move on a ramp at their maximum speed."""

    rad: float
    goal_rad: float
    ending: Ending = Ending()
    completion: Completion = field(default_factory=Completion)


@dataclass
class _Arm:
    """One arm: its commands, and who is waiting for it."""

    model: ArmModel
    limits: MotionLimits
    executor: TrajectoryExecutor
    jaw: _Jaw
    reading: JointReading
    sent: Array
    sent_velocity: Array = field(default_factory=lambda: np.zeros(6))
    limit_use: Array = field(default_factory=lambda: np.zeros(2))
    completion: Completion = field(default_factory=Completion)
    commanded: list[Array] = field(default_factory=list)
    measured: list[Array] = field(default_factory=list)


class Driver:
    """Executes trajectories as set-points, one tick after the other.

    The owner of the hardware or the physics calls :meth:`targets` for the set-points of the next tick, sends them,
    and calls :meth:`note` with what was read. This class does not repeat the checks of the ``Guarded`` around it.

    Args:
        now_s: returns the cell's clock.
        records: whether to keep commands and readings for the results of motions.
    """

    def __init__(self, now_s: Callable[[], float], *, records: bool = True):
        self._now_s, self._records = now_s, records
        self._arms: dict[str, _Arm] = {}
        self._times: list[float] = []
        self._gone = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the arms."""
        return tuple(self._arms)

    def attach(self, name: str, model: ArmModel, limits: MotionLimits, q: Array, jaw_rad: float) -> None:
        """Add an arm that rests at the command (6,)."""
        reading = JointReading(self._now_s(), np.array(q, dtype=np.float64), jaw_rad)
        self._arms[name] = _Arm(
            model, limits, TrajectoryExecutor(model, limits, q), _Jaw(jaw_rad, jaw_rad), reading, reading.q
        )

    def _arm(self, name: str) -> _Arm:
        if name not in self._arms:
            raise UnknownName("arm", name, self._arms)
        return self._arms[name]

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        return self._arm(arm).reading

    def setpoint(self, arm: str, ahead_s: float = 0.0) -> SetPoint:
        """Return the arm's command now, or ``ahead_s`` from now if no other motion starts until then."""
        return self._arm(arm).executor.now(self._now_s() + ahead_s)

    def jaw_command_rad(self, arm: str) -> float:
        """Return the opening that the jaws are commanded to now."""
        return self._arm(arm).jaw.rad

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, all starting at the same tick."""
        for name in motions:
            if self._arm(name).executor.moving:
                raise ArmMoving(name)
        return await self._execute(motions)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions of these arms without a stop."""
        for name in motions:
            self._arm(name)
        return await self._execute(motions)

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Do nothing: trajectories are executed as they are."""

    def start(self, motions: Mapping[str, Trajectory]) -> dict[str, Completion]:
        """Start trajectories at this tick, whatever the arms were doing; each completion tells when it is over."""
        now, waiting = self._now_s(), {}
        for name, trajectory in motions.items():
            arm = self._arm(name)
            if arm.executor.moving:
                self._finish(arm, _ending(MotionEnd.REPLACED, name))
            arm.executor.start(trajectory, now)
            waiting[name] = arm.completion = Completion()
        return waiting

    async def _execute(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        if self._gone:
            await trio.lowlevel.checkpoint()
            return {name: self._never_started(name) for name in motions}
        first, waiting = len(self._times), self.start(motions)
        try:
            for completion in waiting.values():
                await completion.over.wait()
        except trio.Cancelled:
            with trio.CancelScope(shield=True):
                mine = [name for name, completion in waiting.items() if self._arms[name].completion is completion]
                self._brake(mine, MotionEnd.CANCELLED)
                for completion in waiting.values():
                    await completion.over.wait()
            raise
        return {name: self._result(name, first, done.last, done.ending) for name, done in waiting.items()}

    def start_jaw(self, arm: str, angle_rad: float) -> Completion:
        """Ramp the jaws to this opening at maximum speed from this tick on; the completion tells when they arrived."""
        jaw = self._arm(arm).jaw
        jaw.completion.finish(_ending(MotionEnd.REPLACED, arm, "the jaws were given another target"), len(self._times))
        jaw.goal_rad, jaw.ending, jaw.completion = angle_rad, Ending(), Completion()
        return jaw.completion

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Ramp the jaws to this opening at maximum speed; return when the ramp has ended and they have settled."""
        jaw = self._arm(arm).jaw
        if self._gone:
            await trio.lowlevel.checkpoint()
            return self._never_started(arm)
        first, completion = len(self._times), self.start_jaw(arm, angle_rad)
        try:
            await completion.over.wait()
        except trio.Cancelled:
            if jaw.completion is completion:
                jaw.goal_rad = jaw.rad
            raise
        if completion.ending.ended is MotionEnd.DONE:
            await trio.sleep(JAW_REST_S)
        return self._result(arm, first, len(self._times), completion.ending)

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest on their paths; their jaws stop too."""
        self._brake(arms or self.names, MotionEnd.HELD, reason)

    def cancel(self, *arms: str) -> None:
        """Bring these arms to rest because the script that moved them was cancelled."""
        self._brake(arms, MotionEnd.CANCELLED)

    def fault(self, *arms: str, reason: TrocarError | str) -> None:
        """Bring these arms to rest because something is wrong."""
        self._brake(arms, MotionEnd.FAULT, reason)

    def _brake(self, arms: Iterable[str], ended: MotionEnd, reason: TrocarError | str = "") -> None:
        for name in arms:
            arm, ending = self._arm(name), _ending(ended, name, reason)
            arm.executor.brake(self._now_s(), ending)
            if arm.jaw.rad != arm.jaw.goal_rad:
                arm.jaw.goal_rad, arm.jaw.ending = arm.jaw.rad, ending

    def abandon(self, reason: str) -> None:
        """Tell every script that waits, now or later, that the physics or the connection is gone."""
        self._gone = reason
        for name, arm in self._arms.items():
            ending = _ending(MotionEnd.FAULT, name, reason)
            if arm.executor.moving:
                arm.executor.freeze(self._now_s())
                self._finish(arm, ending)
            arm.jaw.completion.finish(ending, len(self._times))

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        for name in arms or self.names:
            while self._arm(name).executor.moving:
                await self._arm(name).completion.over.wait()

    def targets(self, name: str, times_s: Array) -> tuple[Array, Array, Array]:
        """Return joints (n, 6), velocities (n, 6) and jaw openings (n,) to send at evenly spaced future times."""
        arm = self._arms[name]
        q, velocity = arm.executor.samples(times_s)
        arm.sent = q[-1]
        step_s = float(times_s[0] - self._now_s())
        if arm.executor.moving or arm.sent_velocity.any():
            before = np.concatenate([arm.sent_velocity[None], velocity[:-1]])
            change = (velocity - before) / step_s
            shares = np.abs(velocity) / arm.limits.velocity, np.abs(change) / arm.limits.acceleration
            arm.limit_use = np.maximum(arm.limit_use, [share.max() for share in shares])
            arm.sent_velocity = velocity[-1]
        step = arm.model.jaw.max_speed * step_s
        jaws = []
        for _ in times_s:
            arm.jaw.rad += min(max(arm.jaw.goal_rad - arm.jaw.rad, -step), step)
            jaws.append(arm.jaw.rad)
        return q, velocity, np.array(jaws)

    def remaining(self, name: str) -> tuple[Trajectory, float] | None:
        """Return the trajectory that an arm is executing and its start on the clock; None at rest."""
        return self._arm(name).executor.remaining(self._now_s(), TICK_S)

    def braking(self, name: str) -> bool:
        """Return whether an arm is coming to rest before the end of its motion."""
        return self._arm(name).executor.braking

    def widest_jaw_rad(self, name: str) -> float:
        """Return the widest opening of an arm's jaws from now until they reach their goal."""
        jaw = self._arm(name).jaw
        return max(jaw.rad, jaw.goal_rad)

    def limit_use(self, name: str) -> tuple[float, float]:
        """Return the largest share of an arm's velocity and acceleration limits used so far."""
        velocity, acceleration = self._arm(name).limit_use.tolist()
        return velocity, acceleration

    def idle(self, name: str) -> bool:
        """Return whether neither the arm nor its jaws are commanded to move."""
        arm = self._arms[name]
        return not arm.executor.moving and arm.jaw.rad == arm.jaw.goal_rad

    def note(self, now_s: float, readings: Mapping[str, JointReading]) -> None:
        """Record the readings at the end of a tick; wake the scripts whose motions have ended.

        Args:
            now_s: the clock at the end of the tick.
            readings: of the arms that answered; the others keep their last one.
        """
        if self._records:
            self._times.append(now_s)
        for name, arm in self._arms.items():
            arm.reading = readings.get(name, arm.reading)
            if self._records:
                arm.commanded.append(appended(arm.sent, arm.jaw.rad))
                arm.measured.append(appended(arm.reading.q, arm.reading.jaw_rad))
            ending = arm.executor.advance(now_s)
            if ending is not None:
                self._finish(arm, ending)
            if arm.jaw.rad == arm.jaw.goal_rad:
                arm.jaw.completion.finish(arm.jaw.ending, len(self._times))

    def _finish(self, arm: _Arm, ending: Ending) -> None:
        arm.completion.finish(ending, len(self._times))

    def _never_started(self, name: str) -> MotionResult:
        return MotionResult.not_started(MotionEnd.FAULT, ArmStopped(name, self._gone))

    def _result(self, name: str, first: int, last: int, ending: Ending) -> MotionResult:
        arm = self._arms[name]
        commanded, measured = (np.array(rows[first:last]).reshape(-1, 7) for rows in (arm.commanded, arm.measured))
        return MotionResult(np.array(self._times[first:last]), commanded, measured, ending.ended, ending.cause)


def _ending(ended: MotionEnd, arm: str, reason: TrocarError | str = "") -> Ending:
    """Return the ending of an arm's motion, with the reason as a typed error."""
    return Ending(ended, reason if isinstance(reason, TrocarError) else ArmStopped(arm, reason or ended.value))
