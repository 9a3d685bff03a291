"""What an arm of a station reaches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3, TURN
from trocar.lab.station import StationArm

STRAIGHT = (SO3.identity(),)
"""The tip's rotation when it is aligned with the base."""

_QUARTERS = [TURN * k / 4 for k in range(4)]
_FACES = [*(SO3.axis("y", angle) for angle in _QUARTERS), SO3.axis("x", TURN / 4), SO3.axis("x", -TURN / 4)]
ALL_WAYS = tuple(face @ SO3.axis("z", angle) for face in _FACES for angle in _QUARTERS)
"""The 24 orientations of a cube."""


def reaches(arm: StationArm, p_world_m: NDArray[np.float64], turns: Sequence[SO3] = STRAIGHT) -> NDArray[np.bool_]:
    """Return which points of the world the tip of an arm reaches, (n,).

    Args:
        arm: the arm and its base.
        p_world_m: (n, 3) points.
        turns: rotations of the tip against the base; one that can be reached is enough.
    """
    p_base = arm.T_world_base.inverse().apply(p_world_m)
    return np.array([any(_reaches(arm, SE3.from_parts(turn, p)) for turn in turns) for p in p_base], dtype=bool)


def _reaches(arm: StationArm, T_base_tip: SE3) -> bool:
    try:
        ik(arm.model, T_base_tip)
    except OutOfReach:
        return False
    return True
