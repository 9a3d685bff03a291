"""What one arm's joints should do, and where its commands are now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.calibration.hysteresis import HysteresisState
from trocar.errors import TrocarError
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CommandRequest:
    """What one arm's joints should do, and where its commands are now.

    Attributes:
        memory: of the cables, up to the commands that were sent last.
        desired: of the true joints (rad, m), from its first knot on. It may start and end in motion; after an end in
            motion it is braked to rest.
        q_start: (6,) command that is being sent now. It may differ from what the model expects there.
        velocity_start: (6,) its velocity.
        limits: of the commands' velocity and acceleration.
        lower: (6,) least commands. Where the desired joints themselves lie below, commands may as well.
        upper: (6,) greatest commands, likewise.
    """

    memory: HysteresisState
    desired: Trajectory
    q_start: Array
    velocity_start: Array
    limits: MotionLimits
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        for name in ("q_start", "velocity_start", "lower", "upper"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (6,) or not np.all(np.isfinite(value)):
                raise TrocarError(f"a request of commands needs six finite numbers as {name}, got {value.tolist()}")
            object.__setattr__(self, name, value)
        over = np.abs(self.velocity_start) / self.limits.velocity
        if over.max() > 1 + 1e-6:
            raise TrocarError(
                f"the commands of joint {np.argmax(over) + 1} already run at {over.max():.2f} times their limit of "
                "velocity; let them slow down before a new motion"
            )
