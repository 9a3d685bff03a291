"""Sutures of a plan that would cross in the tissue: reported, but not a constraint on the plan."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.tasks.suture.planning.primitive import bite_m, tip_farthest_m
from trocar.tasks.suture.planning.setup import SutureSetup

Pair = tuple[int, int]


def crossing_sutures(setup: SutureSetup, positions_rad: ArrayLike, directions: ArrayLike) -> tuple[Pair, ...]:
    """Return the pairs of sutures whose paths, seen from above, cross or come closer than the wire's thickness.

    Depth is ignored: where two paths cross as seen from above, one may pass below the other.

    Args:
        setup: circle, needle, insertion.
        positions_rad: (n,) positions of the sutures.
        directions: (n,) each one of ``DIRECTIONS``.
    """
    paths = tip_paths_m(setup, positions_rad, directions)
    pairs = combinations(range(len(paths)), 2)
    return tuple((i, j) for i, j in pairs if _distance_m(paths[i], paths[j]) < setup.needle.wire_m)


def tip_paths_m(setup: SutureSetup, positions_rad: ArrayLike, directions: ArrayLike) -> NDArray[np.float64]:
    """Return start and end (n, 2, 2) of the tip's paths in the tissue, seen from above, in the circle's frame."""
    thetas, signs = np.asarray(positions_rad, dtype=np.float64), np.asarray(directions)
    out = np.stack([np.cos(thetas), np.sin(thetas)], -1)
    heading = -signs[:, None] * np.stack([-out[:, 1], out[:, 0]], -1)
    back = bite_m(setup) / 2 if setup.insertion.theta_is == "middle" else 0.0
    entry = setup.circle.radius_m * out - back * heading
    return np.stack([entry, entry + tip_farthest_m(setup) * heading], 1)


def _distance_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the distance between two line segments (2, 2) in the plane."""
    if _cross(one, other) and _cross(other, one):
        return 0.0
    ends = [(end, segment) for points, segment in ((one, other), (other, one)) for end in points]
    return min(_from_segment_m(end, segment) for end, segment in ends)


def _cross(line: NDArray[np.float64], segment: NDArray[np.float64]) -> bool:
    """Return whether the ends of a segment lie on opposite sides of the line through another."""
    along, to_ends = line[1] - line[0], segment - line[0]
    sides = along[0] * to_ends[:, 1] - along[1] * to_ends[:, 0]
    return bool(sides[0] * sides[1] < 0)


def _from_segment_m(point: NDArray[np.float64], segment: NDArray[np.float64]) -> float:
    """Return the distance of a point from a segment."""
    along, to_point = segment[1] - segment[0], point - segment[0]
    share = np.clip(to_point @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(to_point - share * along))
