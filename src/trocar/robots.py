"""Wrappers that any robot may wear."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from trocar.arms import ArmModel, MotionLimits
from trocar.calibration.compensation import Compensator, sample_positions
from trocar.cell import Execution, JointReading, Robot
from trocar.errors import TrocarError
from trocar.motion.limits import limit_use, require_range
from trocar.trajectory import Trajectory

KNOT_S = 0.020
"""Spacing of the knots of a corrected trajectory: two control periods."""
SMOOTHING = 3
"""Knots over which a correction is averaged: the play's kinks would ask for endless acceleration."""

CLIPPED = 5e-3
"""A correction may lack this much (rad, m) at the end of a joint's range before the range counts as left."""

RANGE_GUARD = 5e-3
"""Corrected commands keep this far (rad, m) inside the joints' ranges."""


class Calibrated:
    """A robot whose cables are compensated: scripts speak of true joints, the robot gets commands.

    Innermost it should wear :class:`Guarded`, which then sees the corrected command.

    Args:
        robot: what it wraps.
        arms: models by name.
        compensators: of the arms whose cables are compensated.
        stop_at_limits: refuse a motion whose correction would leave a joint's range, instead of leaving it uncorrected.
    """

    def __init__(
        self,
        robot: Robot,
        arms: Mapping[str, ArmModel],
        compensators: Mapping[str, Compensator],
        stop_at_limits: bool = False,
    ):
        self._stop_at_limits = stop_at_limits
        self._robot = robot
        self._arms = dict(arms)
        self._compensators = dict(compensators)
        self._desired: dict[str, NDArray[np.float64]] = {}
        for arm in self._compensators:
            self._rest(arm)

    def _rest(self, arm: str) -> None:
        """Forget the past: the arm rests where it is commanded now, its slack unknown."""
        q_cmd = self._robot.read(arm).q
        compensator = self._compensators[arm]
        compensator.start(q_cmd)
        self._desired[arm] = compensator.model.step(compensator.model.start(q_cmd), q_cmd)[0]

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state with the joints where the model believes they are."""
        reading = self._robot.read(arm)
        return JointReading(reading.time_s, self._desired.get(arm, reading.q).copy(), reading.jaw_rad)

    async def move(self, arm: str, trajectory: Trajectory) -> Execution:
        """Run a trajectory of the true joints."""
        if arm not in self._compensators:
            return await self._robot.move(arm, trajectory)
        try:
            corrected = self.corrected(arm, trajectory)
        except TrocarError:
            self._rest(arm)
            raise
        self._desired[arm] = trajectory(trajectory.times_s[-1])
        try:
            return await self._robot.move(arm, corrected)
        except BaseException:
            self._rest(arm)
            raise

    def corrected(self, arm: str, trajectory: Trajectory) -> Trajectory:
        """Return the commands that bring the joints along this trajectory; the model's memory moves on.

        A command never leaves its joint's range: what would be needed beyond it stays uncorrected.

        Raises:
            TrocarError: it is to stop at limits, and more than ``CLIPPED`` would stay uncorrected.
        """
        compensator = self._compensators[arm]
        times, desired = trajectory.sample(KNOT_S)
        model = compensator.model
        rows = np.arange(len(times))
        positions = rows if model.rate_independent else sample_positions(desired, model.training)
        at = np.interp(positions, rows, times) - trajectory.times_s[0]
        commands = compensator.path(trajectory(at + trajectory.times_s[0]))
        times = times - trajectory.times_s[0]
        raw = commands - trajectory(at + trajectory.times_s[0])
        raw[0] = self._robot.read(arm).q - desired[0]
        correction = np.column_stack([np.interp(times, at, column) for column in raw.T])
        smooth = uniform_filter1d(correction, SMOOTHING, axis=0, mode="nearest")
        fade = np.minimum(1.0, np.minimum(np.arange(len(times)), np.arange(len(times))[::-1]) / SMOOTHING)
        correction = correction + fade[:, None] * (smooth - correction)
        wanted = desired + correction
        lower, upper = self._arms[arm].lower + RANGE_GUARD, self._arms[arm].upper - RANGE_GUARD
        commands = np.where((desired > lower) & (desired < upper), np.clip(wanted, lower, upper), wanted)
        if self._stop_at_limits:
            _require_inside(self._arms[arm], wanted, commands)
        velocity = np.gradient(commands, times, axis=0)
        velocity[[0, -1]] = 0.0
        velocity[commands != wanted] = 0.0
        return Trajectory.hermite(times, commands, velocity)

    async def jaw(self, arm: str, angle_rad: float) -> Execution:
        """Drive the jaws; their cables are taken as they are."""
        return await self._robot.jaw(arm, angle_rad)

    def hold(self, arm: str) -> None:
        """Stop this arm."""
        self._robot.hold(arm)
        if arm in self._compensators:
            self._rest(arm)


def _require_inside(arm: ArmModel, wanted: NDArray[np.float64], commands: NDArray[np.float64]) -> None:
    """Raise a sentence unless the wanted commands (n, 6) are the ones within the joints' ranges."""
    lacking = np.abs(wanted - commands).max(axis=0)
    index = int(np.argmax(lacking))
    if lacking[index] <= CLIPPED:
        return
    joint = arm.joints[index]
    row = int(np.argmax(np.abs(wanted - commands)[:, index]))
    scale, unit = (1e3, "mm") if joint.prismatic else (180 / math.pi, "deg")
    raise TrocarError(
        f"joint {joint.name!r} would need the command {scale * wanted[row, index]:.1f} {unit} to make up for its "
        f"cables, outside [{scale * joint.lower:.1f}, {scale * joint.upper:.1f}] {unit}"
    )


class Guarded:
    """A robot that refuses commands outside the joints' ranges and slows down those above its limits."""

    def __init__(self, robot: Robot, arms: Mapping[str, ArmModel], limits: Mapping[str, MotionLimits]):
        self._robot = robot
        self._arms = dict(arms)
        self._limits = dict(limits)

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state."""
        return self._robot.read(arm)

    async def move(self, arm: str, trajectory: Trajectory) -> Execution:
        """Run the trajectory, stretched in time as far as its limits of velocity ask for.

        Raises:
            TrocarError: a joint would leave its range; nothing has moved then.
        """
        if arm not in self._arms:
            raise TrocarError(f"arm {arm!r} is not guarded here; choose one of {', '.join(self._arms)}")
        require_range(self._arms[arm], trajectory)
        use = limit_use(self._arms[arm], trajectory, self._limits[arm])
        return await self._robot.move(arm, trajectory.stretched(max(1.0, use.velocity_ratio)))

    async def jaw(self, arm: str, angle_rad: float) -> Execution:
        """Drive the jaws."""
        return await self._robot.jaw(arm, angle_rad)

    def hold(self, arm: str) -> None:
        """Stop this arm."""
        self._robot.hold(arm)


class Recorded:
    """A robot that keeps what was executed, for the trial's file.

    Outermost it keeps what the script asked for, innermost what the cables were sent.

    Attributes:
        executions: (arm, execution) in the order in which they ended.
        asked: (arm, time_s (n,), joints (n, 6)) of each motion in the same order: the trajectory as it was asked for,
            at the times at which it was executed.
    """

    def __init__(self, robot: Robot):
        self._robot = robot
        self.asked: list[tuple[str, NDArray[np.float64], NDArray[np.float64]]] = []
        self.executions: list[tuple[str, Execution]] = []

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state."""
        return self._robot.read(arm)

    async def move(self, arm: str, trajectory: Trajectory) -> Execution:
        """Run the trajectory and keep what was executed."""
        execution = await self._robot.move(arm, trajectory)
        self.executions.append((arm, execution))
        share = np.arange(1, len(execution.times_s) + 1) / max(1, len(execution.times_s))
        at = trajectory.times_s[0] + share * trajectory.duration_s
        self.asked.append((arm, execution.times_s, trajectory(at)))
        return execution

    async def jaw(self, arm: str, angle_rad: float) -> Execution:
        """Drive the jaws and keep what was executed."""
        execution = await self._robot.jaw(arm, angle_rad)
        self.executions.append((arm, execution))
        return execution

    def hold(self, arm: str) -> None:
        """Stop this arm."""
        self._robot.hold(arm)
