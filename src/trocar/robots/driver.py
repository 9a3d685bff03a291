"""Several arms on one clock behind the ``Robot`` protocol, for any controller that takes set-points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.cell import JointReading, MotionEnd, MotionResult, SetPoint
from trocar.errors import TrocarError
from trocar.robots.executor import TrajectoryExecutor
from trocar.trajectory import Trajectory

TICK_S = 0.010
"""Period of the arms' controller (Hwang et al. 2022, V-B: 10 ms)."""

JAW_REST_S = 0.05
"""Time after the end of the jaws' ramp until they hold still."""


@dataclass
class _Jaw:
    """Jaws that move on a ramp at their maximum speed."""

    rad: float
    goal_rad: float
    ended: tuple[MotionEnd, str] = (MotionEnd.DONE, "")
    arrived: trio.Event = field(default_factory=trio.Event)


@dataclass
class _Ticket:
    """What a script that waits for a motion is told: how it ended, and the row after its last one."""

    ended: tuple[MotionEnd, str] = (MotionEnd.DONE, "")
    last: int = 0
    over: trio.Event = field(default_factory=trio.Event)


@dataclass
class _Arm:
    """One arm: its commands, and who is waiting for it."""

    model: ArmModel
    limits: MotionLimits
    executor: TrajectoryExecutor
    jaw: _Jaw
    reading: JointReading
    sent: NDArray[np.float64]
    sent_velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    use: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    ticket: _Ticket = field(default_factory=_Ticket)
    commanded: list[NDArray[np.float64]] = field(default_factory=list)
    measured: list[NDArray[np.float64]] = field(default_factory=list)


class Driver:
    """Plays trajectories back as set-points, one tick after the other.

    The owner of the hardware or the physics calls :meth:`targets` for the set-points of the next tick, sends them,
    and calls :meth:`note` with what was read. This class does not repeat the checks of the ``Guarded`` around it.

    Args:
        now_s: returns the cell's clock.
    """

    def __init__(self, now_s: Callable[[], float]):
        self._now_s = now_s
        self._arms: dict[str, _Arm] = {}
        self._times: list[float] = []
        self._gone = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the arms."""
        return tuple(self._arms)

    def attach(self, name: str, model: ArmModel, limits: MotionLimits, q: NDArray[np.float64], jaw_rad: float) -> None:
        """Add an arm that rests at the command (6,)."""
        reading = JointReading(self._now_s(), np.array(q, dtype=np.float64), jaw_rad)
        self._arms[name] = _Arm(
            model, limits, TrajectoryExecutor(model, limits, q), _Jaw(jaw_rad, jaw_rad), reading, reading.q
        )

    def _arm(self, name: str) -> _Arm:
        if name not in self._arms:
            raise TrocarError(f"arm {name!r} is not in this cell; choose one of {', '.join(self._arms)}")
        return self._arms[name]

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        return self._arm(arm).reading

    def setpoint(self, arm: str) -> SetPoint:
        """Return what the arm is commanded now."""
        return self._arm(arm).executor.now(self._now_s())

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, all starting at the same tick."""
        for name in motions:
            if self._arm(name).executor.moving:
                raise TrocarError(f"arm {name!r} is already moving; await its motion, or replace it")
        return await self._play(motions)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Let trajectories take over from what the arms are doing now."""
        for name in motions:
            arm = self._arm(name)
            if arm.executor.moving:
                self._finish(arm, (MotionEnd.REPLACED, MotionEnd.REPLACED.value))
        return await self._play(motions)

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Do nothing: trajectories are played as they are."""

    async def _play(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        if self._gone:
            await trio.lowlevel.checkpoint()
            return {name: self._execution(name, 0, 0, (MotionEnd.FAULT, self._gone)) for name in motions}
        first, now = len(self._times), self._now_s()
        tickets: dict[str, _Ticket] = {}
        for name, trajectory in motions.items():
            arm = self._arm(name)
            arm.executor.start(trajectory, now)
            tickets[name] = arm.ticket = _Ticket()
        try:
            for ticket in tickets.values():
                await ticket.over.wait()
        except trio.Cancelled:
            with trio.CancelScope(shield=True):
                mine = [name for name, ticket in tickets.items() if self._arms[name].ticket is ticket]
                self._brake(mine, MotionEnd.CANCELLED, MotionEnd.CANCELLED.value)
                for ticket in tickets.values():
                    await ticket.over.wait()
            raise
        return {name: self._execution(name, first, ticket.last, ticket.ended) for name, ticket in tickets.items()}

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Ramp the jaws to this opening at their speed; return when they arrived or stall."""
        jaw = self._arm(arm).jaw
        if self._gone:
            await trio.lowlevel.checkpoint()
            return self._execution(arm, 0, 0, (MotionEnd.FAULT, self._gone))
        jaw.arrived.set()  # scripts that wait for an earlier goal
        jaw.goal_rad, jaw.arrived, jaw.ended = angle_rad, trio.Event(), (MotionEnd.DONE, "")
        first, arrived = len(self._times), jaw.arrived
        try:
            await arrived.wait()
        except trio.Cancelled:
            if jaw.arrived is arrived:
                jaw.goal_rad = jaw.rad
            raise
        ended = jaw.ended if jaw.arrived is arrived else (MotionEnd.REPLACED, "the jaws were given another target")
        if ended[0] is MotionEnd.DONE:
            await trio.sleep(JAW_REST_S)
        return self._execution(arm, first, len(self._times), ended)

    def hold(self, *arms: str, reason: str = "") -> None:
        """Bring these arms, or all, to rest on their paths; their jaws stop too."""
        self._brake(arms or self.names, MotionEnd.HELD, reason or MotionEnd.HELD.value)

    def fault(self, *arms: str, reason: str) -> None:
        """Bring these arms to rest because something is wrong."""
        self._brake(arms, MotionEnd.FAULT, reason)

    def _brake(self, arms: Sequence[str], ended: MotionEnd, reason: str) -> None:
        for name in arms:
            arm = self._arm(name)
            arm.executor.brake(self._now_s(), ended, reason)
            if arm.jaw.rad != arm.jaw.goal_rad:
                arm.jaw.goal_rad, arm.jaw.ended = arm.jaw.rad, (ended, reason)

    def abandon(self, reason: str) -> None:
        """Notify every script that waits, or will wait, that the physics or the connection is gone."""
        self._gone = reason
        for arm in self._arms.values():
            if arm.executor.moving:
                arm.executor.freeze(self._now_s())
                self._finish(arm, (MotionEnd.FAULT, reason))
            arm.jaw.ended = (MotionEnd.FAULT, reason)
            arm.jaw.arrived.set()

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        for name in arms or self.names:
            while self._arm(name).executor.moving:
                await self._arm(name).ticket.over.wait()

    def targets(
        self, name: str, times_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return joints (n, 6), velocities (n, 6) and jaw openings (n,) to be sent at evenly spaced times to come."""
        arm = self._arms[name]
        q, velocity = arm.executor.samples(times_s)
        arm.sent = q[-1]
        step_s = float(times_s[0] - self._now_s())
        if arm.executor.moving or arm.sent_velocity.any():
            change = np.diff(velocity, axis=0, prepend=arm.sent_velocity[None]) / step_s
            shares = np.abs(velocity) / arm.limits.velocity, np.abs(change) / arm.limits.acceleration
            arm.use = np.maximum(arm.use, [share.max() for share in shares])
            arm.sent_velocity = velocity[-1]
        step = arm.model.jaw.max_speed * step_s
        jaws = []
        for _ in times_s:
            arm.jaw.rad += min(max(arm.jaw.goal_rad - arm.jaw.rad, -step), step)
            jaws.append(arm.jaw.rad)
        return q, velocity, np.array(jaws)

    def remaining(self, name: str) -> tuple[Trajectory, float] | None:
        """Return what an arm is still playing and the clock at its start; None at rest."""
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
        velocity, acceleration = self._arm(name).use.tolist()
        return velocity, acceleration

    def idle(self, name: str) -> bool:
        """Return whether neither the arm nor its jaws are commanded to move."""
        arm = self._arms[name]
        return not arm.executor.moving and arm.jaw.rad == arm.jaw.goal_rad

    def note(self, now_s: float, readings: Mapping[str, JointReading]) -> None:
        """Record what was read at the end of a tick; notify the scripts that wait for what has ended.

        Args:
            now_s: the clock at the end of the tick.
            readings: of the arms that answered; the others keep their last one.
        """
        self._times.append(now_s)
        for name, arm in self._arms.items():
            arm.reading = readings.get(name, arm.reading)
            arm.commanded.append(np.append(arm.sent, arm.jaw.rad))
            arm.measured.append(np.append(arm.reading.q, arm.reading.jaw_rad))
            ended = arm.executor.advance(now_s)
            if ended is not None:
                self._finish(arm, ended)
            if arm.jaw.rad == arm.jaw.goal_rad:
                arm.jaw.arrived.set()

    def _finish(self, arm: _Arm, ended: tuple[MotionEnd, str]) -> None:
        arm.ticket.ended, arm.ticket.last = ended, len(self._times)
        arm.ticket.over.set()

    def _execution(self, name: str, first: int, last: int, ended: tuple[MotionEnd, str]) -> MotionResult:
        arm = self._arms[name]
        return MotionResult(
            times_s=np.array(self._times[first:last]),
            commanded=np.array(arm.commanded[first:last]).reshape(-1, 7),
            measured=np.array(arm.measured[first:last]).reshape(-1, 7),
            ended=ended[0],
            reason=ended[1],
        )
