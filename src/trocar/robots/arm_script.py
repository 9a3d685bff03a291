"""One arm as a script uses it; its actions are noted in the cell's log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trocar.arms import ArmModel, MotionLimits
from trocar.calibration.excitation import EXERCISE_RAD
from trocar.cell import Cell, MotionResult, Result
from trocar.errors import UnknownName
from trocar.geometry.arrays import Array
from trocar.motion import rest_to_rest
from trocar.trajectory import Trajectory

MOST_ZERO_RAD = 0.15
"""Larger encoder readings of closed jaws are rejected (assumed)."""
INSIDE = 1e-6
"""A wrist is exercised up to this distance (rad, m) from the ends of its range: rounding must not take it beyond."""


@dataclass(eq=False)
class ArmScript:
    """One arm of a cell.

    Attributes:
        cell: the laboratory.
        name: of the arm.
        settle_s: rest after a motion before the jaws act.
        limits_share: share of the arm's limits used by motions that are given by start and end only.
        jaw_zero_rad: the encoder reading of closed jaws; see :meth:`zero_jaw`.
    """

    cell: Cell
    name: str
    settle_s: float
    limits_share: float = 1.0
    jaw_zero_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in self.cell.arms:
            raise UnknownName("arm", self.name, self.cell.arms)

    @property
    def model(self) -> ArmModel:
        """Return the arm's model."""
        return self.cell.arms[self.name]

    @property
    def limits(self) -> MotionLimits:
        """Return the velocity and acceleration limits of motions that are given by start and end only."""
        return self.cell.limits[self.name].scaled(self.limits_share)

    @property
    def q(self) -> Array:
        """Return the commanded joints (6,) of the arm: where the next motion starts."""
        return self.cell.robot.setpoint(self.name).q

    @property
    def jaw_rad(self) -> float:
        """Return the jaws' opening as their encoder reads it now, relative to its reading when they are closed."""
        return self.cell.robot.read(self.name).jaw_rad - self.jaw_zero_rad

    async def exercise_wrist(self) -> None:
        """Turn the wrist back and forth, so that the slack in the cables is known, whatever it was before.

        Near the end of a joint's range, it turns as far, but further to the other side.
        """
        home, lower, upper = self.q, self.model.lower + INSIDE, self.model.upper - INSIDE
        swing = np.minimum([0.0, 0.0, 0.0, *EXERCISE_RAD], (upper - lower) / 2)
        middle = np.clip(home, lower + swing, upper - swing)
        for q in (middle + swing, middle - swing, np.clip(home, lower, upper)):
            await self.go(q)

    async def go(self, q: Array) -> MotionResult:
        """Move from rest to rest, to these joints (6,)."""
        return await self.move(rest_to_rest(self.q, q, self.limits))

    async def move(self, trajectory: Trajectory) -> MotionResult:
        """Run a trajectory."""
        with self.cell.log.span(self.name, "motion"):
            return (await self.cell.robot.move({self.name: trajectory}))[self.name]

    async def jaw(self, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening."""
        with self.cell.log.span(self.name, "jaw"):
            return await self.drive_jaw(angle_rad)

    async def drive_jaw(self, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening while the arm does something else."""
        return await self.cell.robot.jaw(self.name, angle_rad + self.jaw_zero_rad)

    async def zero_jaw(self, closed_rad: float) -> None:
        """Close the empty jaws, and take their encoder reading as zero.

        If they read wide open, an object holds them open, and the zero is left unchanged.

        Args:
            closed_rad: target, small enough that the drive presses the jaws together.
        """
        await self.jaw(closed_rad)
        if abs(self.jaw_rad) < MOST_ZERO_RAD:
            self.jaw_zero_rad += self.jaw_rad

    async def settle(self) -> None:
        """Wait at rest, so that the jaws act while everything is still."""
        with self.cell.log.span(self.name, "settling"):
            await self.cell.clock.sleep(self.settle_s)

    async def compute(self, what: str, budget_s: float, function: Callable[[], Result]) -> Result:
        """Run a computation; in simulation the clock counts its declared budget, and the real time is noted too."""
        return await self.cell.compute(self.name, what, function, budget_s)
