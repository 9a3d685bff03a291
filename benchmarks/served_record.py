"""Plugin of a served cell that records its arms' set-points at once, so that nothing is lost however the cell ends.

    TROCAR_SERVED_RECORD=record.bin trocar crtk serve peg-transfer --plugin benchmarks/served_record.py

A row is the machine's monotonic clock, the number of the arm, and joints and velocities at each set-point of a tick.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar.arms import MotionLimits
from trocar.sim.robot import SERVO_S, TICK_SERVOS, SimRobot

WHERE = "TROCAR_SERVED_RECORD"
WIDTH = 2 + 12 * TICK_SERVOS


def write_down(path: Path) -> None:
    """Record the set-points of every arm from now on, unbuffered and in whole rows."""
    file, targets = path.open("ab", buffering=0), SimRobot.targets

    def noted(self: SimRobot, name: str, times_s: np.ndarray):
        q, velocity, jaws = targets(self, name, times_s)
        file.write(np.array([time.monotonic(), self.names.index(name), *q.ravel(), *velocity.ravel()]).tobytes())
        return q, velocity, jaws

    SimRobot.targets = noted  # type: ignore[method-assign]


@dataclass(frozen=True)
class Use:
    """What arms did over some time: the largest shares of their limits, and whether they were at rest at the end."""

    velocity: float
    acceleration: float
    at_rest: bool


class ServedRecord:
    """The record of a served cell, which may still grow.

    Args:
        path: of the file.
        limits: of the arms, in the cell's order.
    """

    def __init__(self, path: Path, limits: list[MotionLimits]):
        self._path, self._limits = path, limits

    def __len__(self) -> int:
        return self._path.stat().st_size // (8 * WIDTH) if self._path.is_file() else 0

    def rows(self, first: int) -> np.ndarray:
        """Return all whole rows (n, WIDTH) from row ``first`` on."""
        count = len(self) - first
        if count <= 0:
            return np.zeros((0, WIDTH))
        with self._path.open("rb") as file:
            file.seek(8 * WIDTH * first)
            return np.frombuffer(file.read(8 * WIDTH * count)).reshape(-1, WIDTH)

    def moving(self, first: int) -> bool:
        """Return whether an arm has moved since row ``first``."""
        return bool(self.rows(first)[:, 2 + 6 * TICK_SERVOS :].any())

    def use(self, first: int) -> Use:
        """Return the use of the limits since row ``first``, by the positions and by the velocities that were set."""
        rows, shares, at_rest = self.rows(first), np.zeros(2), True
        for number, limits in enumerate(self._limits):
            mine = rows[rows[:, 1] == number, 2:].reshape(-1, 2, TICK_SERVOS, 6)
            if len(mine) < 3:
                continue
            q, velocity = mine[:, 0].reshape(-1, 6), mine[:, 1].reshape(-1, 6)
            speeds = np.abs(np.vstack([velocity[1:], np.diff(q, axis=0) / SERVO_S])) / limits.velocity
            changes = np.vstack([np.diff(velocity, axis=0) / SERVO_S, np.diff(q, 2, axis=0) / SERVO_S**2])
            shares = np.maximum(shares, [speeds.max(), (np.abs(changes) / limits.acceleration).max()])
            at_rest = at_rest and not velocity[-1].any()
        return Use(float(shares[0]), float(shares[1]), at_rest)


if WHERE in os.environ:
    write_down(Path(os.environ[WHERE]))
