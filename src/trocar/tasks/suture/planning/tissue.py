"""Sutures of a plan that would cross in the tissue: reported, but not a constraint on the plan."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.suture.planning.primitive import Suture

Pair = tuple[int, int]


def crossing_sutures(sutures: Sequence[Suture]) -> tuple[Pair, ...]:
    """Return the pairs of sutures whose paths, seen from above, cross or come closer than the wire's thickness.

    Depth is ignored: where two paths cross as seen from above, one may pass below the other.
    """
    paths = [suture.path_ends_m for suture in sutures]
    return tuple(
        (i, j)
        for i, j in combinations(range(len(paths)), 2)
        if _distance_m(paths[i], paths[j]) < sutures[i].setup.needle.wire_m
    )


def _distance_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the distance between two line segments (2, 2) in the plane."""
    if _parts(one, other) and _parts(other, one):
        return 0.0
    ends = [(end, segment) for points, segment in ((one, other), (other, one)) for end in points]
    return min(_from_segment_m(end, segment) for end, segment in ends)


def _parts(line: NDArray[np.float64], segment: NDArray[np.float64]) -> bool:
    """Return whether the ends of a segment lie on opposite sides of the line through another."""
    along, to_ends = line[1] - line[0], segment - line[0]
    sides = along[0] * to_ends[:, 1] - along[1] * to_ends[:, 0]
    return bool(sides[0] * sides[1] < 0)


def _from_segment_m(point: NDArray[np.float64], segment: NDArray[np.float64]) -> float:
    along, to_point = segment[1] - segment[0], point - segment[0]
    share = np.clip(to_point @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(to_point - share * along))
