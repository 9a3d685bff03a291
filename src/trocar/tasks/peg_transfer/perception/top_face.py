"""The outline of a block's top face as a signed-distance map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.geometry import TURN
from trocar.tasks.peg_transfer.shapes import Block

STEP_M = 0.2e-3
REACH_M = 14e-3


@dataclass(frozen=True, eq=False)
class TopFace:
    """Signed distance to the outline of the top face in the block frame's x, y: positive on the face.

    Attributes:
        distance_m: (n, n) distance at the nodes ``-REACH_M + k STEP_M``, indexed [x, y].
        gradient: (n, n, 2) its gradient with respect to x, y.
        area_m2: area of the face.
    """

    distance_m: NDArray[np.float64]
    gradient: NDArray[np.float64]
    area_m2: float

    def at(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (...) at points (..., 2), bilinear between nodes and constant beyond the border."""
        i, j, a, b = _cell(xy_m, len(self.distance_m))
        d = self.distance_m
        return (1 - a) * ((1 - b) * d[i, j] + b * d[i, j + 1]) + a * ((1 - b) * d[i + 1, j] + b * d[i + 1, j + 1])

    def nearest(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (...) at the nodes nearest to points (..., 2), which is coarse but fast."""
        at = np.clip(np.rint((xy_m + REACH_M) / STEP_M), 0, len(self.distance_m) - 1).astype(np.intp)
        return self.distance_m[at[..., 0], at[..., 1]]

    def slope(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the gradient (..., 2) at the nearest node."""
        i, j, a, b = _cell(xy_m, len(self.distance_m))
        return self.gradient[i + (a > 0.5), j + (b > 0.5)]


def _cell(xy_m: NDArray[np.float64], count: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    at = np.clip((xy_m + REACH_M) / STEP_M, 0, count - 1.001)
    node = at.astype(np.intp)
    part = at - node
    return node[..., 0], node[..., 1], part[..., 0], part[..., 1]


@lru_cache(maxsize=8)
def top_face(block: Block) -> TopFace:
    """Return the map of this block's top face."""
    angle = np.linspace(0, TURN, 720, endpoint=False)
    radius = np.concatenate([block.hole_radius_m(angle), block.outer_radius_m(angle)])
    both = np.concatenate([angle, angle])
    outline = KDTree(np.column_stack([radius * np.cos(both), radius * np.sin(both)]))
    ticks = np.arange(round(2 * REACH_M / STEP_M) + 1) * STEP_M - REACH_M
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    r, a = np.hypot(x, y), np.arctan2(y, x)
    inside = (r >= block.hole_radius_m(a)) & (r <= block.outer_radius_m(a))
    distance = outline.query(np.stack([x, y], -1))[0] * np.where(inside, 1.0, -1.0)
    gradient = np.stack(np.gradient(distance, STEP_M), -1)
    return TopFace(distance, gradient, float(inside.sum()) * STEP_M**2)
