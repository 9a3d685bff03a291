"""Walls made of capsules: a receptacle that stands on the table."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InvalidInput
from trocar.geometry import SE3
from trocar.geometry.arrays import finite
from trocar.motion.obstacles import Capsule

GAP_M = 1.5e-3
"""Greatest gap between two rows of a wall: nothing that is 2 mm thick passes."""
HIGHEST_M = 10.0


def wall(name: str, start_m: ArrayLike, end_m: ArrayLike, height_m: float, radius_m: float) -> dict[str, Capsule]:
    """Return an upright wall as rows of capsules, from its foot to its top, by name.

    >>> list(wall("fence", [0, 0, 0], [0.1, 0, 0], height_m=0.01, radius_m=0.002))
    ['fence 0', 'fence 1', 'fence 2']

    Args:
        name: of the wall; rows are numbered.
        start_m: (3,) of its foot in the world, in the middle of its thickness.
        end_m: (3,) where its foot ends.
        height_m: from the foot to the top, along z of the world.
        radius_m: half its thickness.
    """
    if not (0 < 2 * radius_m <= height_m <= HIGHEST_M):
        raise InvalidInput(
            "a wall",
            f"cannot be {height_m} m high and {2 * radius_m} m thick",
            f"give a thickness above 0, and a height of at least that and at most {HIGHEST_M} m",
        )
    rows = ceil((height_m - 2 * radius_m) / (2 * radius_m + GAP_M) - 1e-9) + 1
    ends = finite(f"the foot of wall {name!r}", [start_m, end_m], 2, 3)  # type: ignore[list-item]
    up = np.array([0.0, 0.0, 1.0])
    heights_m = np.linspace(radius_m, height_m - radius_m, rows) if rows > 1 else [radius_m]
    return {
        f"{name} {k}": Capsule(ends[0] + h * up, ends[1] + h * up, radius_m=radius_m) for k, h in enumerate(heights_m)
    }


def open_box(
    name: str, T_world_box: SE3, inside_m: tuple[float, float], height_m: float, radius_m: float
) -> dict[str, Capsule]:
    """Return the four walls of a box without a lid, by name: a receptacle. Its floor is what it stands on.

    >>> receptacle = open_box("receptacle", T_world_left, (0.11, 0.07), 0.02, 0.002)

    Args:
        name: of the box; walls and rows are numbered.
        T_world_box: pose of the middle of its floor, z straight up.
        inside_m: its length along x and y, between the walls.
        height_m: of the walls.
        radius_m: half the walls' thickness, outside of what is inside.
    """
    if not min(finite(f"the inside of box {name!r}", inside_m, 2)) > 0:
        raise InvalidInput(f"box {name!r}", f"is {inside_m} m wide inside", "give two lengths above 0")
    x, y = (length / 2 + radius_m for length in inside_m)
    corners = T_world_box.apply(np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]))
    walls: dict[str, Capsule] = {}
    for k in range(4):
        walls |= wall(f"{name} {k}", corners[k], corners[(k + 1) % 4], height_m, radius_m)
    return walls
