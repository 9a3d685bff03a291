"""The scene of a trial: a phantom with a circle drawn on it, a needle, and its stand. Simulator truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.lab.flaws import Flaw
from trocar.tasks.suture.needle import Needle

LONGEST_CHORD_RAD = np.radians(10.0)
"""Longest chord of the polygon that approximates the wire: .03 mm off the arc at a needle radius of 8 mm."""
NEEDLE = Flaw(
    "needle",
    "place of a needle that a person loads or sets up against the agreed one (1 x: SD .3 mm on each axis, 3 deg)",
    "",
    (0.0003, 0.0524),
    (0.0, 0.0),
    "assumed",
    tasks=("suture",),
)
"""Error with which a person loads the needle (entry point ``trocar.flaws``)."""


@dataclass(frozen=True)
class SutureScene:
    """A flat phantom, and a needle that a person places between the open jaws, or that stands beside the circle.

    Attributes:
        T_world_circle: pose of the circle: z out of the phantom's surface, origin at the circle's centre.
        circle_radius_m: radius of the circle.
        needle: the needle.
        T_tip_needle: agreed pose of the needle in the arm's tip when a person loads it.
        T_needle_loaded: true pose of the needle in the agreed one, for each loading in turn.
        T_world_stand: pose of the stand that holds the needle at first; None: a person holds it and loads it.
    """

    T_world_circle: SE3
    circle_radius_m: float
    needle: Needle
    T_tip_needle: SE3
    T_needle_loaded: tuple[SE3, ...] = (SE3.identity(),)
    T_world_stand: SE3 | None = None

    @property
    def wire_points_m(self) -> NDArray[np.float64]:
        """Return points (n, 3) along the wire in the needle's frame, from the tip to the tail."""
        count = int(np.ceil(self.needle.arc_rad / LONGEST_CHORD_RAD)) + 1
        return SO3.axis("z", -np.linspace(0.0, self.needle.arc_rad, count)).apply(self.needle.p_tip_m)
