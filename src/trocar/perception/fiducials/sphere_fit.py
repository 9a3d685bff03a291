"""Spheres through points of a depth image, by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STEPS = 12
DONE_M = 1e-6
"""Maximum number of Gauss-Newton steps of a fit, and the change at which it ends."""
LARGEST_M = 0.1
"""A larger radius means that the points lie on a plane or a line."""
GATE_SIGMAS, MIN_GATE_M = 3.0, 0.3e-3
"""A point counts if its distance from the sphere is below this many SDs; the gate never shrinks below the minimum.
Pixels at the rim, between the sphere and what is behind it, are rejected this way."""


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere through points.

    Attributes:
        center_m: (3,) in the frame of the points.
        radius_m: found, or as given.
        rms_m: RMS distance of the points that count.
        share: share of the points that count.
    """

    center_m: NDArray[np.float64]
    radius_m: float
    rms_m: float
    share: float


def fit_sphere(
    points_m: NDArray[np.float64], radius_m: float | None = None, near_m: NDArray[np.float64] | None = None
) -> SphereFit | None:
    """Return the sphere nearest to points (n, 3) that are seen from the origin; None if it cannot be found.

    Gauss-Newton on the distances from the surface; outliers are left out step by step.

    Args:
        points_m: on the side of the sphere that faces the origin.
        radius_m: of the sphere, if known; None: it is fitted too.
        near_m: (3,) guess of its centre; None: behind the points.
    """
    if len(points_m) < 4:
        return None
    radius = radius_m or 0.5 * float(np.ptp(points_m[:, :2], axis=0).max())
    if near_m is None:
        center = np.median(points_m, axis=0)
        center = center * (1.0 + 0.7 * radius / max(float(np.linalg.norm(center)), 1e-9))  # behind the visible points
    else:
        center = near_m
    free = radius_m is None
    used = np.ones(len(points_m), dtype=bool)
    for _ in range(STEPS):
        away = points_m - center
        distance = np.linalg.norm(away, axis=1)
        residual = distance - radius
        spread = 1.4826 * float(np.median(np.abs(residual)))
        used = np.abs(residual) < max(GATE_SIGMAS * spread, MIN_GATE_M)
        if used.sum() < 4:
            return None
        slopes = -away[used] / np.maximum(distance[used], 1e-12)[:, None]
        slopes = np.column_stack([slopes, np.full(len(slopes), -1.0)]) if free else slopes
        normal = slopes.T @ slopes
        try:
            step = np.linalg.solve(normal, -slopes.T @ residual[used])
        except np.linalg.LinAlgError:  # points on a line
            return None
        center = center + step[:3]
        radius += float(step[3]) if free else 0.0
        if not np.isfinite(center).all() or not 0.0 < radius < LARGEST_M:
            return None
        if np.abs(step).max() < DONE_M:
            break
    residual = np.linalg.norm(points_m[used] - center, axis=1) - radius
    return SphereFit(center, float(radius), float(np.sqrt(np.mean(residual**2))), float(used.mean()))
