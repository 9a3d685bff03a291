"""The variants of the task, one arm or two, and their default stations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.suture.planning.two_arms import SecondArm

if TYPE_CHECKING:
    from trocar.lab import Station  # planning needs no station

SINGLE, TWO = "single-arm", "two-arms"
STATIONS = {SINGLE: "suture", TWO: "suture-pair"}
"""Default station of each variant."""


def pair_of(station: Station) -> tuple[NDArray[np.float64], SecondArm]:
    """Return the parked joints (6,) of a station's first arm, and its second arm."""
    first, second = (station.arm(name) for name in list(station.arms)[:2])
    return first.park_q(), SecondArm(second.model, second.T_world_base, second.park_q())
