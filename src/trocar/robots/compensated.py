"""A robot whose cables are compensated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trocar.arms import ArmModel, MotionLimits
from trocar.calibration.command_path import CommandPath, CommandRequest, command_paths
from trocar.calibration.compensation import HysteresisState, inverse
from trocar.calibration.models import CableModel
from trocar.cell import Clock, JointReading, Log, MotionEnd, MotionResult, Robot, SetPoint
from trocar.errors import ArmMoving, ArmStopped, OutOfReach, TrocarError
from trocar.geometry.arrays import Array
from trocar.log import timed
from trocar.motion.following import step_towards
from trocar.robots.guarded import START_TOLERANCE, start_mismatch
from trocar.robots.supervised import Supervised, Verb
from trocar.trajectory import Trajectory

CLIPPED = 5e-3
"""With ``stop_at_limits``, a motion is refused if a joint's range cuts more than this (rad, m) off a correction."""
RANGE_GUARD = 5e-3
"""Corrected commands keep this far (rad, m) inside the joints' ranges."""
MISSED = 1e-3
"""If the model predicts that joints end further (rad, m) than this from the requested end, its estimate is used."""
ENDED_S = 1e-6
"""A motion whose time is this close to its end has ended."""
BUDGET_S = 0.05
"""Computing time declared for the commands of a motion that was not prepared."""
SAME = 1e-9
"""Commands this close (rad, m) are the same: the predicted and the real end of a motion."""
SLOWED = 1.001
"""A motion that is slowed down by more than this factor is logged."""


class _Start(NamedTuple):
    """Where the commands of a motion begin."""

    q_cmd: Array
    velocity: Array
    after: CommandPath | None  # what was sent before
    then: bool = False  # the motion starts when that has ended, not now


class _Prepared(NamedTuple):
    """Commands found in advance for motions, by arm, and where they begin: at rest."""

    motions: Mapping[str, Trajectory]
    starts: Mapping[str, _Start]
    paths: Mapping[str, CommandPath]

    def suits(self, motions: Mapping[str, Trajectory], starts: Mapping[str, _Start]) -> bool:
        """Return whether these are the motions, and the arms are where they were expected to be."""
        return (
            motions.keys() == self.motions.keys()
            and all(motions[name] is self.motions[name] for name in motions)
            and all(
                start.after is starts[name].after
                and np.abs(start.q_cmd - starts[name].q_cmd).max() <= SAME
                and not starts[name].velocity.any()
                for name, start in self.starts.items()
            )
        )


@dataclass(eq=False)
class Compensated:
    """A robot whose cables are compensated: scripts work in true joints, the robot gets commands.

    All commands of a motion are found before it starts, within the limits, so that a cable's slack is crossed in time
    (``trocar.calibration.command_path``). The model's hysteresis state follows the commands that were really sent, so a
    motion may be stopped half-way, or replaced while it runs.

    Attributes:
        robot: what it wraps; its innermost wrapper should be ``Guarded``, which then sees the commands.
        arms: models by name.
        models: initial cable models of the arms that are compensated.
        limits: of velocity and acceleration of the commands, by arm.
        clock: of the cell.
        log: of the cell; computing times, and motions that were slowed down, are noted there.
        stop_at_limits: refuse a motion whose correction would leave a joint's range, instead of leaving it uncorrected.
    """

    robot: Robot
    arms: Mapping[str, ArmModel]
    models: Mapping[str, CableModel]
    limits: Mapping[str, MotionLimits]
    clock: Clock
    log: Log
    stop_at_limits: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        at_rest = {arm: (model, self.robot.setpoint(arm).q) for arm, model in self.models.items()}
        self._rested = {arm: HysteresisState.at_rest(model, q_cmd) for arm, (model, q_cmd) in at_rest.items()}
        self._paths: dict[str, CommandPath] = {}
        self._prepared: dict[frozenset[str], _Prepared] = {}
        self._computing: dict[str, TrocarError | None] = {}  # arms whose commands are being found: why they were held
        self._resting: dict[str, tuple[CommandPath | None, Array, Array]] = {}

    def read(self, arm: str) -> JointReading:
        """Return the last encoder readings, with the joints replaced by the model's estimate."""
        reading = self.robot.read(arm)
        if arm not in self._rested:
            return reading
        return JointReading(reading.time_s, self._estimated(arm, self.robot.setpoint(arm)), reading.jaw_rad)

    def setpoint(self, arm: str) -> SetPoint:
        """Return the current command for the true joints.

        For an arm that was stopped on its way, this is the model's estimate of the joints: if a cable's slack was being
        crossed, the arm may rest some way from where the joints were asked to be.
        """
        sent = self.robot.setpoint(arm)
        if arm not in self._rested:
            return sent
        path = self._paths.get(arm)
        ended = path is not None and sent.path_s >= path.desired.duration_s - ENDED_S
        if path is None or not sent.on_path or (not sent.moving and (not ended or path.missing.max() > MISSED)):
            q, velocity = self._estimated(arm, sent), np.zeros(6)
        else:
            q, velocity = path.desired(sent.path_s), sent.path_rate * path.desired(sent.path_s, 1)
        return SetPoint(sent.time_s, q, velocity, sent.moving, sent.path_s, sent.path_rate, sent.on_path)

    def expected(self, arm: str) -> Trajectory | None:
        """Return the requested joint motion of an arm's current commands, on their time; None: unknown."""
        path = self._paths.get(arm)
        another = isinstance(self.robot, Supervised) and self.robot.plays_another(arm)
        return None if path is None or another else path.desired

    def _estimated(self, arm: str, sent: SetPoint) -> Array:
        """Return the model's estimate of the joints (6,); evaluated only once while the arm is at rest."""
        known = self._resting.get(arm)
        if known is not None and known[0] is self._paths.get(arm) and np.array_equal(known[1], sent.q):
            return known[2]
        joints = self._memory(arm, sent).joints(sent.q)
        if not sent.moving:
            self._resting[arm] = self._paths.get(arm), sent.q, joints
        return joints

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories of the true joints, from rest.

        Raises:
            ArmMoving: an arm is moving, or the commands of its next motion are still being found.
            OutOfReach: with ``stop_at_limits``, more than ``CLIPPED`` would stay uncorrected.
            MotionRefused: as for the wrapped robot.
        """
        for arm in motions:
            if arm in self._computing or self.robot.setpoint(arm).moving:
                raise ArmMoving(arm)
        starts = {arm: self._now(arm) for arm in motions if arm in self._rested}
        prepared = self._prepared.pop(frozenset(motions), None)
        if not starts:
            return await self.robot.move(motions)
        if prepared is not None and prepared.suits(motions, starts):
            return await self._sent(self.robot.move, motions, prepared.paths)
        self._computing |= dict.fromkeys(motions)
        try:
            paths, seconds = await self.clock.compute(lambda: self._found(motions, starts), BUDGET_S)
        finally:
            held = [self._computing.pop(arm) for arm in motions]
        self.log.compute("compensation", seconds, BUDGET_S)
        cause = next((cause for cause in held if cause is not None), None)
        if cause is not None:
            return {arm: MotionResult.not_started(MotionEnd.HELD, cause) for arm in motions}
        return await self._sent(self.robot.move, motions, paths)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions by trajectories of the true joints, without a stop."""
        starts = {arm: self._now(arm) for arm in motions if arm in self._rested}
        paths, seconds = timed(lambda: self._found(motions, starts))
        if paths:
            self.log.compute("compensation", seconds, BUDGET_S)
        return await self._sent(self.robot.replace, motions, paths)

    async def follow(self, motions: Mapping[str, Trajectory], period_s: float) -> Mapping[str, MotionResult]:
        """Follow one step of a stream: motions that are replaced by others after each period.

        The next step is unknown, so a slack is crossed only when a joint reverses, as fast as the limits allow; the
        joint stands still meanwhile. For a motion that is known as a whole, ``replace`` is better.

        Args:
            motions: as ``trocar.motion.following.step_towards`` makes them. After the period, the commands come to rest
                in their own way.
            period_s: time until other motions take over.
        """
        paths, seconds = timed(lambda: {arm: self._step(arm, motion, period_s) for arm, motion in motions.items()})
        self.log.compute("compensation", seconds, period_s)
        return await self._sent(self.robot.replace, motions, {arm: path for arm, path in paths.items() if path})

    def _step(self, arm: str, motion: Trajectory, period_s: float) -> CommandPath | None:
        """Return the commands of one period of a stream; None for an arm that is not compensated."""
        if arm not in self._rested:
            return None
        sent, model = self.robot.setpoint(arm), self.arms[arm]
        memory, velocity = self._memory(arm, sent), motion(period_s, 1)
        asked = motion(period_s) + velocity * period_s / 2  # next control point of the stream's B-spline
        error = memory.joints(sent.q) - sent.q
        wanted = inverse(memory.model, memory.state, asked, asked - error)
        q_cmd = np.clip(wanted, model.lower + RANGE_GUARD, model.upper - RANGE_GUARD)
        commands = step_towards(q_cmd, velocity, sent.q, sent.velocity, self.limits[arm], period_s)
        return CommandPath(commands, motion, np.zeros(6), np.abs(wanted - q_cmd), wanted, 1.0, memory)

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Find the commands of motions in advance, so that ``move`` starts them at once.

        For a moving arm, they begin where its current motion ends.

        Raises:
            MotionRefused: as ``move``.
        """
        starts = {arm: self._next(arm) for arm in motions if arm in self._rested}
        if starts:
            self._prepared[frozenset(motions)] = _Prepared(dict(motions), starts, self._found(motions, starts))

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws, whose cables are not compensated."""
        return await self.robot.jaw(arm, angle_rad)

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest; a motion whose commands are still being found does not start."""
        for arm in arms or tuple(self._computing):
            if arm in self._computing:
                held = isinstance(reason, TrocarError)
                self._computing[arm] = reason if held else ArmStopped(arm, reason or MotionEnd.HELD.value)
        self.robot.hold(*arms, reason=reason)

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        await self.robot.rest(*arms)

    def _memory(self, arm: str, sent: SetPoint) -> HysteresisState:
        """Return the hysteresis state of an arm after all commands up to now."""
        path = self._paths.get(arm)
        if path is None:
            return self._rested[arm]
        memory = path.memory_at(sent.path_s)
        if sent.on_path:
            return memory
        left = path.commands(min(sent.path_s, path.commands.duration_s))
        if not np.any(left != sent.q):
            return memory
        # braking left the path: add the straight way from the path to the command that was sent
        aside = Trajectory.hermite([0.0, 1.0], [left, sent.q], np.tile(sent.q - left, (2, 1)))
        return memory.after(aside, 1.0)

    def _now(self, arm: str) -> _Start:
        """Return where a motion that starts now begins, for a compensated arm."""
        sent = self.robot.setpoint(arm)
        return _Start(sent.q, sent.velocity, self._paths.get(arm))

    def _next(self, arm: str) -> _Start:
        """Return where a motion that follows the arm's current one begins."""
        path = self._paths.get(arm)
        if path is None or not self.robot.setpoint(arm).moving:
            return self._now(arm)
        return _Start(path.commands(path.commands.times_s[-1]), np.zeros(6), path, then=True)

    def _joints(self, arm: str, start: _Start) -> tuple[Array, HysteresisState]:
        """Return the command (6,) for the true joints at a start, and the hysteresis state."""
        if not start.then or start.after is None:
            return self.setpoint(arm).q, self._memory(arm, self.robot.setpoint(arm))
        path, memory = start.after, start.after.memory_at(start.after.commands.duration_s)
        missed = path.missing.max() > MISSED
        return memory.joints(start.q_cmd) if missed else path.desired(path.desired.times_s[-1]), memory

    def _found(self, motions: Mapping[str, Trajectory], starts: Mapping[str, _Start]) -> dict[str, CommandPath]:
        """Return the command paths of the compensated arms among these."""
        paths = command_paths({arm: self._request(arm, motions[arm], start) for arm, start in starts.items()})
        if self.stop_at_limits:
            for arm, path in paths.items():
                _require_inside(self.arms[arm], path)
        return paths

    def _request(self, arm: str, desired: Trajectory, start: _Start) -> CommandRequest:
        model = self.arms[arm]
        joints, memory = self._joints(arm, start)
        jump = float(np.max(np.abs(desired(desired.times_s[0]) - joints)))
        if jump > START_TOLERANCE:
            raise start_mismatch(arm, jump)
        return CommandRequest(
            memory=memory,
            desired=desired,
            q_start=start.q_cmd,
            velocity_start=start.velocity,
            limits=self.limits[arm],
            lower=model.lower + RANGE_GUARD,
            upper=model.upper - RANGE_GUARD,
        )

    async def _sent(
        self, verb: Verb, motions: Mapping[str, Trajectory], paths: Mapping[str, CommandPath]
    ) -> Mapping[str, MotionResult]:
        """Send commands instead of the motions, all slowed down by one factor if needed."""
        self._keep_past(paths)
        stretch = max((path.stretch for path in paths.values()), default=1.0)
        if stretch > SLOWED:
            self.log.event("compensation", arms=sorted(paths), stretch=round(stretch, 4))
        commands = {
            arm: paths[arm].commands if arm in paths else motion.stretched(stretch) for arm, motion in motions.items()
        }
        before = {arm: self._paths[arm] for arm in paths if arm in self._paths}
        self._paths.update(paths)  # the robot starts the motions before it first waits
        try:
            return await verb(commands)
        except TrocarError:  # refused: nothing has moved, or the current motion goes on
            for arm in paths:
                del self._paths[arm]
            self._paths.update(before)
            raise

    def _keep_past(self, arms: Iterable[str]) -> None:
        """Hook, called before these arms' paths change: a subclass that learns keeps what was sent so far."""


def _require_inside(arm: ArmModel, path: CommandPath) -> None:
    """Refuse commands that would have to leave a joint's range to compensate for its cables."""
    index = int(np.argmax(path.lacking))
    if path.lacking[index] <= CLIPPED:
        return
    joint = arm.joints[index]
    raise OutOfReach(
        f"joint {joint.name!r} would need the command {joint.shown(float(path.farthest[index]))} to make up for its "
        f"cables, outside [{joint.shown(joint.lower)}, {joint.shown(joint.upper)}]",
        joint=joint.name,
        by=float(path.lacking[index]),
    )
