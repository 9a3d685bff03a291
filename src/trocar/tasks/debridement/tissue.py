"""A likeness of tissue on the work surface (Kehoe 2014, Fig. 2a): simulator truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3, TURN

HALF_M = (0.16, 0.13)
"""Half the sides of the covered area round the table's origin."""
KINDS = {
    "organ": (7, (0.020, 0.045), (0.6, 1.0), (0.62, 0.44, 0.33)),
    "fat": (16, (0.005, 0.014), (0.5, 1.0), (0.72, 0.63, 0.44)),
    "film": (10, (0.012, 0.030), (0.3, 0.7), (0.70, 0.60, 0.50)),
    "vein": (9, (0.020, 0.045), (0.05, 0.09), (0.34, 0.29, 0.46)),
}
"""Kinds of patches: how many, longest half axis in m, its ratio to the other one, linear colour. None is as red as a
fragment or as saturated as the marks of a gripper: hues of 20 to 45 and 260 deg, all of them pale
(``trocar.perception.color``)."""
GROUND = (0.66, 0.50, 0.39)
"""Colour of the area between patches."""
PROUD_M = 0.6e-3
"""Maximum height of patches; fragments lie on the plane, and 6 to 9 mm of them are visible."""
SEGMENTS = 20
"""Number of corners of a patch's outline."""
SHADE = 0.08
"""Standard deviation of the brightness from patch to patch."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat mound that collides with nothing.

    Attributes:
        half_m: (3,) half axes, and height.
        T_world_patch: pose of its foot.
        color: linear RGB in [0, 1].
    """

    half_m: NDArray[np.float64]
    T_world_patch: SE3
    color: tuple[float, float, float]

    def corners_m(self) -> NDArray[np.float64]:
        """Return the corners (n, 3) of its convex hull in its frame."""
        angles = np.linspace(0.0, TURN, SEGMENTS, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(SEGMENTS)], axis=-1)
        return np.concatenate([ring, [0.8, 0.8, 0.0] * ring + [0.0, 0.0, 1.0]]) * self.half_m


def lay_tissue(T_world_table: SE3, rng: np.random.Generator) -> tuple[Patch, ...]:
    """Return random patches of flesh, fat, film and veins."""
    found = []
    for count, longest, ratio, color in KINDS.values():
        for _ in range(count):
            length = rng.uniform(*longest)
            half = np.array([length, length * rng.uniform(*ratio), PROUD_M * rng.uniform(0.5, 1.0)])
            place = np.append(rng.uniform(-1.0, 1.0, 2) * HALF_M, 0.0)
            turn = SO3.axis("z", rng.uniform(0.0, TURN))
            shade = float(np.clip(1.0 + SHADE * rng.standard_normal(), 0.8, 1.2))
            r, g, b = (shade * part for part in color)
            found.append(Patch(half, T_world_table @ SE3.from_parts(turn, place), (r, g, b)))
    return tuple(found)
