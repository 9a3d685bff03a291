"""Marks on a gripper that a camera must keep seeing: an axis of the tip that faces a point."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, direction
from trocar.geometry.arrays import finite


@dataclass(frozen=True, eq=False)
class Facing:
    """An axis of the tip that stays turned towards a point.

    >>> facing = Facing(axis=[0.0, 1.0, 0.0], towards_m=[-0.05, 0.14, 0.07], max_rad=0.8)  # the jaws' axis, the camera

    Attributes:
        axis: (3,) in the frame of the tip, of any length; a unit vector afterwards.
        towards_m: (3,) in the world, the camera.
        max_rad: the angle between the axis and the direction from the tip to that point stays below this.
    """

    axis: NDArray[np.float64]
    towards_m: NDArray[np.float64]
    max_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "towards_m", finite("'towards_m' of what a tip faces", self.towards_m, 3))
        if not 0 < self.max_rad <= pi:
            raise InvalidInput("a tip", f"may face {self.max_rad} rad aside", "give an angle above 0, up to pi")
        object.__setattr__(self, "axis", direction(self.axis, "the axis that faces a point"))

    def angle_rad(self, T_world_tip: SE3) -> NDArray[np.float64]:
        """Return the angle (...,) by which poses (...,) of the tip face away."""
        axis = T_world_tip.matrix[..., :3, :3] @ self.axis
        way = self.towards_m - T_world_tip.matrix[..., :3, 3]
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        return 2 * np.arctan2(np.linalg.norm(axis - way, axis=-1), np.linalg.norm(axis + way, axis=-1))
