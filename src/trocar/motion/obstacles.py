"""What a motion keeps clear of: obstacles and walls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, direction
from trocar.geometry.arrays import finite
from trocar.geometry.capsules import Capsules

BALL_RADIUS_M = 1e7
"""Radius of the ball that represents a half-space: flat within 1 um over 4 m, and rounding stays below 10 nm."""

BALL_LIFT_M = 1e-6
"""How far that ball is raised, so that it contains all of the half-space nearby."""


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within a radius of a segment, in the world; with one end it is a ball.

    >>> peg = Capsule([0.05, 0.0, 0.0], [0.05, 0.0, 0.02], radius_m=0.002)
    >>> ball = Capsule([0.0, 0.0, 0.1], radius_m=0.01)

    Attributes:
        start_m: (3,).
        end_m: (3,); None: where it starts.
        radius_m: 0 or more.
    """

    start_m: NDArray[np.float64]
    end_m: NDArray[np.float64] | None = None
    radius_m: float = 0.0

    def __post_init__(self) -> None:
        end = self.start_m if self.end_m is None else self.end_m
        object.__setattr__(self, "start_m", finite("the start of a capsule", self.start_m, 3))
        object.__setattr__(self, "end_m", finite("the end of a capsule", end, 3))
        if not (np.isfinite(self.radius_m) and self.radius_m >= 0):
            raise InvalidInput("the radius", f"of a capsule is {self.radius_m} m", "give a finite radius of at least 0")

    def as_capsule(self) -> Capsule:
        """Return itself."""
        return self


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """All points on one side of a plane, in the world: a table, a wall.

    >>> table = HalfSpace(point_m=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])

    Attributes:
        point_m: (3,) on the plane, not more than about 4 m from the arms.
        normal: (3,) pointing out of the solid side, of any length; a unit vector afterwards.
    """

    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_m", finite("the point of a half-space", self.point_m, 3))
        object.__setattr__(self, "normal", direction(self.normal, "the normal of a half-space"))

    def as_capsule(self) -> Capsule:
        """Return a ball so large that it is as good as the half-space, and no smaller where arms are.

        So planners, checks and guards need only one shape.
        """
        return Capsule(self.point_m + (BALL_LIFT_M - BALL_RADIUS_M) * self.normal, radius_m=BALL_RADIUS_M)


Obstacle = Capsule | HalfSpace


def stacked(obstacles: Mapping[str, Obstacle]) -> Capsules:
    """Return the obstacles in order as capsules in the world: ends (k, 2, 3) m, radii (k,)."""
    capsules = [obstacle.as_capsule() for obstacle in obstacles.values()]
    ends = np.array([[capsule.start_m, capsule.end_m] for capsule in capsules], dtype=np.float64)
    return Capsules(ends.reshape(-1, 2, 3), np.array([capsule.radius_m for capsule in capsules], dtype=np.float64))


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
