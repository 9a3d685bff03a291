"""Who sutures, one arm or two, and where if no station is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.suture.planning.two_arms import SecondArm

if TYPE_CHECKING:
    from trocar.lab import Station  # planning needs no station

SINGLE, TWO = "single-arm", "two-arms"
STATIONS = {SINGLE: "suture", TWO: "suture-pair"}
"""Variants, and where each is done if no station is given."""


def pair_of(station: Station) -> tuple[NDArray[np.float64], SecondArm]:
    """Return where the first arm of a station rests (6,), and its second arm."""
    first, second = (station.arm(name) for name in list(station.arms)[:2])
    return first.park_q(), SecondArm(second.model, second.T_world_base, second.park_q())
