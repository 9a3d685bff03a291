"""Results of the stereo vision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3

SAME_M = 0.010
"""Two places this close, seen from above, are the same fragment."""


@dataclass(frozen=True, eq=False)
class SeenFragment:
    """One fragment, or a heap of them that cannot be told apart.

    Attributes:
        p_world_m: (3,) best estimate of its centre of volume.
        extent_m: (2,) long and short extent, seen from above.
        yaw_rad: direction of the long extent in the world's x-y plane, [0, pi).
        height_m: of its middle above the table.
        reference_m: (3,) the paper's reference point: the middle of its area in both pictures, at the depth of their
            disparity.
        lumped: probably several fragments that could not be split.
        area_px: of its pixels in the left picture.
        occluded: something hides a part of it.
    """

    p_world_m: NDArray[np.float64]
    extent_m: NDArray[np.float64]
    yaw_rad: float
    height_m: float
    reference_m: NDArray[np.float64]
    lumped: bool
    area_px: int
    occluded: bool


@dataclass(frozen=True, eq=False)
class SeenGripper:
    """A gripper as found from the marks on its fingers.

    Attributes:
        T_world_tip: pose of the controlled point between the jaws, as the arm's model has it.
        jaw_rad: opening of the jaws.
        marks: how many of its four marks both eyes saw.
        residual_m: RMS residual of the marks, at their distance.
    """

    T_world_tip: SE3
    jaw_rad: float
    marks: int
    residual_m: float


def away_m(fragment: SeenFragment, p_world_m: NDArray[np.float64]) -> float:
    """Return how far a fragment is from a place (3,), seen from above."""
    return float(np.linalg.norm(fragment.p_world_m[:2] - p_world_m[:2]))
