"""The spheres that an instrument wears while it is calibrated: their positions, sizes and colours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, frames
from trocar.errors import InvalidInput, UnknownName
from trocar.geometry.arrays import Array

SHAFT, JAW = "shaft", "jaw"

COLORS = {
    "red": (0.80, 0.06, 0.06),
    "green": (0.05, 0.55, 0.12),
    "blue": (0.06, 0.16, 0.75),
    "yellow": (0.80, 0.65, 0.05),
}
"""Colours of the paint: shares of red, green and blue that it reflects (assumed)."""

_PITCH_FRAME, _YAW_FRAME = 4, 6
"""Indices in ``trocar.arms.frames`` of the frames that carry shaft and jaw; the origin of frame 4 is on the pitch
axis."""


@dataclass(frozen=True)
class Sphere:
    """One painted sphere."""

    part: str  # the part that carries it, 'shaft' or 'jaw'
    color: str  # name in :data:`COLORS`
    radius_m: float
    # on the shaft: (0, 0, distance up the shaft from the pitch axis); on the jaw: in frame 6, whose z is the yaw axis
    # and along whose y the jaws point
    center_m: tuple[float, float, float]


@dataclass(frozen=True)
class Fixture:
    """The spheres that an instrument wears. Two spheres of the same colour on one part must differ in size."""

    spheres: tuple[Sphere, ...]  # one or more on the shaft, three or more on the jaw
    # (3,) middle of the cross in frame 6; thin dark arms lead from it to the jaw's spheres
    hub_m: tuple[float, float, float]
    arm_radius_m: float = 1.5e-3  # of these arms
    # SD of a sphere's position error on each axis after printing and gluing (assumed; the printer's tolerance)
    print_sd_m: float = 0.1e-3

    def __post_init__(self) -> None:
        for part, least in ((SHAFT, 1), (JAW, 3)):
            found = sum(sphere.part == part for sphere in self.spheres)
            if found < least:
                raise InvalidInput("a fixture", f"has {found} spheres on the {part}", f"give {least} or more")
        for sphere in self.spheres:
            if sphere.color not in COLORS:
                raise UnknownName("a sphere's colour", sphere.color, COLORS)

    @cached_property
    def radii_m(self) -> Array:
        """Return the radii (n,)."""
        return np.array([sphere.radius_m for sphere in self.spheres])

    @cached_property
    def centers_m(self) -> Array:
        """Return the centres (n, 3), each in the frame of its part."""
        return np.array([sphere.center_m for sphere in self.spheres])

    @cached_property
    def on_shaft(self) -> NDArray[np.bool_]:
        """Return which spheres (n,) are on the shaft."""
        return np.array([sphere.part == SHAFT for sphere in self.spheres])

    def frame_centers_m(self, arm: ArmModel) -> Array:
        """Return the centres (n, 3) in the arm's frame 4 (shaft) or 6 (jaw)."""
        centers = self.centers_m.copy()
        centers[self.on_shaft, 2] *= arm.wrist_sign  # frame 4's z runs up or down the shaft
        return centers

    def carriers(self, arm: ArmModel, q: ArrayLike) -> Array:
        """Return the pose (..., n, 4, 4), in the arm's base, of the frame that carries each sphere."""
        return frames(arm, q).matrix[..., np.where(self.on_shaft, _PITCH_FRAME, _YAW_FRAME), :, :]

    def base_centers_m(self, arm: ArmModel, q: ArrayLike) -> Array:
        """Return the centres (..., n, 3) in the arm's base at joints (..., 6)."""
        carriers = self.carriers(arm, q)
        return (carriers[..., :3, :3] @ self.frame_centers_m(arm)[:, :, None])[..., 0] + carriers[..., :3, 3]


def _on_shaft(color: str, diameter_mm: float, up_mm: float) -> Sphere:
    return Sphere(SHAFT, color, 5e-4 * diameter_mm, (0.0, 0.0, 1e-3 * up_mm))


def _cross(arm_mm: float, ahead_mm: float, diameter_mm: float) -> tuple[Sphere, ...]:
    """Return four spheres on a cross whose plane is normal to the jaws, this far ahead of the yaw axis."""
    ends = {"red": (1, 1), "green": (1, -1), "blue": (-1, -1), "yellow": (-1, 1)}
    half = 1e-3 * arm_mm / np.sqrt(2.0)
    return tuple(
        Sphere(JAW, color, 5e-4 * diameter_mm, (x * half, 1e-3 * ahead_mm, z * half)) for color, (x, z) in ends.items()
    )


AHEAD_MM = 20.0  # the cross is held by the jaws, whose ends lie 10.2 mm ahead of the yaw axis (assumed)

SIX_SPHERES = Fixture(
    spheres=(_on_shaft("red", 20.0, 15.8 + 35.0), _on_shaft("yellow", 17.0, 15.8), *_cross(35.0, AHEAD_MM, 16.0)),
    hub_m=(0.0, 1e-3 * AHEAD_MM, 0.0),
)
"""Two spheres on the shaft and four on the jaw (Hwang et al. 2022, IV-A)."""
