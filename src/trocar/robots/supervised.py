"""A robot supervised by a person, who permits motions, stops them on their way, and lets them go on."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from trocar.cell import JointReading, MotionEnd, MotionResult, Robot, SetPoint
from trocar.errors import ArmStopped, MotionRefused, TrocarError
from trocar.robots.coordinator import Blocked
from trocar.trajectory import Trajectory

RAMP_S = 0.4
"""Time in which a motion that goes on after a stop reaches its speed."""
KNOT_S = 0.02
"""Time between the knots of the remainder of a motion."""
BACK = 1e-6
"""An arm that a person moved is back if all joints are this near (rad, m) to where they were: rounding."""
LEAST_S = 1e-3
"""A stopped motion with less than this left counts as done."""

Verb = Callable[[Mapping[str, Trajectory]], Awaitable[Mapping[str, MotionResult]]]


class StoppedByPerson(ArmStopped):
    """A person stopped this arm; its motion goes on once the person says so."""

    def __init__(self, arm: str = ""):
        super().__init__(arm, "a person stopped it")


class Vetoed(Blocked):
    """A person said no to the motion of these arms; none has moved, and their script may try something else."""

    def __init__(self, *arms: str):
        super().__init__(arms[0] if len(arms) == 1 else "")
        self.args = (f"a person said no to the motion of {', '.join(arms)}",)


class Supervisor(Protocol):
    """The person, as the robot sees them."""

    async def permit(self, motions: Mapping[str, Trajectory], *, begun: bool = False) -> None:
        """Return once these motions, as they will be sent, may start.

        Args:
            motions: by arm.
            begun: whether they are what is left of motions that were stopped; these cannot be refused.

        Raises:
            Vetoed: the person said no.
        """
        ...

    async def free(self, arm: str) -> None:
        """Return once the arm may be used."""
        ...

    def forbids(self, arm: str) -> bool:
        """Return whether the arm is stopped or in the person's hands, so that nothing else may move it now."""
        ...


class _Rest(NamedTuple):
    """The remainder of a motion, from rest, and the time along the whole motion as a function of its own time."""

    motion: Trajectory
    path_s: Trajectory


class Supervised:
    """Starts each motion when a person permits it; one that the person stopped goes on from where its arm is.

    To a script, a stopped motion only takes longer: its path stays the same, and ``setpoint`` tells how far along it
    the arm is. So this wrapper goes below the compensation of the cables, just above the guard. A ``replace`` while an
    arm is stopped does not wait: it ends as ``HELD``, and its caller goes on from where the arm is.

    Args:
        robot: what it wraps.
        supervisor: the person.

    Attributes:
        robot: what it wraps.
        jaws_rad: last commanded opening of the jaws, by arm.
        running: the motions that run now, by arm, as they were sent.
    """

    def __init__(self, robot: Robot, supervisor: Supervisor):
        self.robot, self._supervisor = robot, supervisor
        self.jaws_rad: dict[str, float] = {}
        self.running: dict[str, Trajectory] = {}
        self._lent: dict[str, SetPoint] = {}
        self._rests: dict[str, _Rest] = {}

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        return self.robot.read(arm)

    def setpoint(self, arm: str) -> SetPoint:
        """Return the current command; ``path_s`` counts along the whole motion as it was asked for."""
        now, rest, lent = self.robot.setpoint(arm), self._rests.get(arm), self._lent.get(arm)
        if lent is not None:
            back = not now.moving and bool(np.abs(now.q - lent.q).max() < BACK)
            away = replace(now, path_s=lent.path_s, path_rate=0.0, on_path=False)
            return replace(lent, time_s=now.time_s) if back else away
        if rest is None:
            return now
        rate = now.path_rate * float(rest.path_s(now.path_s, 1)[0])
        return replace(now, path_s=float(rest.path_s(now.path_s)[0]), path_rate=rate)

    def lend(self, arm: str) -> None:
        """Note that a person moves an arm that is at rest, and brings it back before anything else moves it.

        Meanwhile ``setpoint`` reports it as off the path of its last motion; once it is back, as before.
        """
        self._lent[arm] = self.setpoint(arm)

    def plays_another(self, arm: str) -> bool:
        """Return whether the arm's current or last motion is only a remainder of the requested one, or a person's."""
        return arm in self._rests or arm in self._lent

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Compute in advance what motions need."""
        self.robot.prepare(motions)

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, once they are permitted.

        Raises:
            Vetoed: the person said no.
            MotionRefused: as the wrapped robot.
        """
        await self._supervisor.permit(motions)
        return await self._played(self.robot.move, motions)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions; while an arm is stopped, return ``HELD`` at once."""
        if any(self._supervisor.forbids(arm) for arm in motions):
            return {arm: MotionResult.not_started(MotionEnd.HELD, StoppedByPerson(arm)) for arm in motions}
        return await self._played(self.robot.replace, motions)

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws once the arm may be used; if the person stops it, they go on afterwards."""
        while True:
            await self._supervisor.free(arm)
            self.jaws_rad[arm] = angle_rad
            result = await self.robot.jaw(arm, angle_rad)
            if not isinstance(result.cause, StoppedByPerson):
                return result

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest."""
        self.robot.hold(*arms, reason=reason)

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        await self.robot.rest(*arms)

    async def _played(self, verb: Verb, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run motions, and the remainders of those that the person stops."""
        results = dict(await self._sent(verb, motions, {}))
        while stopped := [arm for arm, result in results.items() if isinstance(result.cause, StoppedByPerson)]:
            left = {arm: rest for arm in stopped if (rest := self._left(arm, motions[arm]))}
            for arm in set(stopped) - set(left):
                results[arm] = replace(results[arm], ended=MotionEnd.DONE, cause=None)
            if left:
                await self._supervisor.permit({arm: rest.motion for arm, rest in left.items()}, begun=True)
                results |= await self._went_on(left, results)
        return results

    async def _went_on(self, left: Mapping[str, _Rest], results: Mapping[str, MotionResult]) -> dict[str, MotionResult]:
        """Run the remainders of motions, and return the results of the whole motions.

        If the robot refuses, another arm may still be in the way: try again once all arms rest. If it refuses again,
        the motions end as ``HELD`` where they were stopped.
        """
        motions = {arm: rest.motion for arm, rest in left.items()}
        try:
            went_on = await self._sent(self.robot.move, motions, left)
        except MotionRefused:
            await self.robot.rest()
            try:
                went_on = await self._sent(self.robot.move, motions, left)
            except MotionRefused as error:
                return {arm: replace(results[arm], cause=error) for arm in left}
        return {arm: _joined(results[arm], result) for arm, result in went_on.items()}

    async def _sent(
        self, verb: Verb, motions: Mapping[str, Trajectory], rests: Mapping[str, _Rest]
    ) -> Mapping[str, MotionResult]:
        """Run motions, or remainders of motions; if they are refused, restore what was known of the last ones."""
        known, lent = self._forget(motions)
        self._rests |= rests
        before = {arm: self.running[arm] for arm in motions if arm in self.running}
        self.running |= motions
        try:
            return await verb(motions)
        except TrocarError:  # nothing has moved
            self._forget(motions)
            self._rests |= known
            self._lent |= lent
            self.running |= before  # they go on
            raise
        finally:
            for arm in [arm for arm, motion in motions.items() if self.running.get(arm) is motion]:
                del self.running[arm]  # no other one has replaced it

    def _forget(self, arms: Iterable[str]) -> tuple[dict[str, _Rest], dict[str, SetPoint]]:
        """Forget, and return, what was known of these arms' last motions."""
        rests = {arm: self._rests.pop(arm) for arm in arms if arm in self._rests}
        return rests, {arm: self._lent.pop(arm) for arm in arms if arm in self._lent}

    def _left(self, arm: str, motion: Trajectory) -> _Rest | None:
        """Return the remainder of a motion from where the stopped arm rests; None: nothing is left."""
        now = self.setpoint(arm)
        start_s, end_s = min(now.path_s, motion.times_s[-1]), motion.times_s[-1]
        left_s = float(end_s - start_s)
        if left_s < LEAST_S:
            return None
        ramp_s = min(RAMP_S, left_s)
        times = np.linspace(0.0, left_s + ramp_s / 2, max(2, int(np.ceil((left_s + ramp_s / 2) / KNOT_S))) + 1)
        u = np.minimum(times / ramp_s, 1.0)
        rate = u**2 * (3 - 2 * u)
        path_s = start_s + np.where(u < 1.0, ramp_s * (u**3 - u**4 / 2), times - ramp_s / 2)
        path_s[-1] = end_s
        aside = (now.q - motion(start_s))[None]  # where braking had to leave the path; it dies away with the ramp
        q = motion(path_s) + aside * (1 - rate)[:, None]
        velocity = motion(path_s, 1) * rate[:, None] - aside * (6 * u * (1 - u) / ramp_s)[:, None]
        return _Rest(Trajectory.hermite(times, q, velocity), Trajectory.hermite(times, path_s[:, None], rate[:, None]))


def _joined(first: MotionResult, second: MotionResult) -> MotionResult:
    times_s = np.concatenate([first.times_s, second.times_s])
    commanded = np.concatenate([first.commanded, second.commanded])
    measured = np.concatenate([first.measured, second.measured])
    return MotionResult(times_s, commanded, measured, second.ended, second.cause)
