"""Fixed things in the world that must not be touched: capsules, balls and half-spaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import direction
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
