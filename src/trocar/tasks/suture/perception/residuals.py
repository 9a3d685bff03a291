"""How far what images show of a needle is from a pose of it, and how that changes with the pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.tasks.suture.perception.arc import NeedleArc
from trocar.tasks.suture.perception.evidence import Evidence

POINT_SD_M, RAY_SD_PX = 0.35e-3, 0.25
"""SDs of a point's distance from the wire, and of the distance by which a ray misses it or passes through it."""
ROBUST = 1.5
"""A residual of more SDs than this counts less (Cauchy)."""
TOGETHER = 4.0
"""This many neighbouring points and rays share their error and count as one (chosen so that errors of looks in the cell
are as large as stated)."""
STEEP = 0.4
"""If the sine of the angle between ray and wire is less, depth tells nothing about the wire."""
ASIDE_M = 0.5e-3
"""A ray that meets steel, and passes the wire so far aside, shows another place of it."""


def normal_equations(
    evidence: Evidence, T_camera_needle: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return information (6, 6) and gradient (6,) of the fit's cost at a pose, and the residuals of the points."""
    T = T_camera_needle.inverse()
    behind, by_behind = behind_wire(evidence.points, T, arc)
    missed, by_missed = closest(evidence.through, T, arc)
    entered, by_entered = closest(evidence.past, T, arc)
    left = float(1.48 * np.median(np.abs(behind))) if len(behind) else np.inf
    missed, entered = np.maximum(missed, 0.0), np.minimum(entered, 0.0)
    ray_sd_m = RAY_SD_PX * evidence.pixel_m
    residual = np.concatenate([behind / POINT_SD_M, missed / ray_sd_m, entered / ray_sd_m])
    slopes = np.concatenate(
        [
            by_behind / POINT_SD_M,
            np.where(missed[:, None] > 0.0, by_missed, 0.0) / ray_sd_m,
            np.where(entered[:, None] < 0.0, by_entered, 0.0) / ray_sd_m,
        ]
    )
    weighed = slopes.T / (1.0 + (residual / ROBUST) ** 2) / TOGETHER
    return weighed @ slopes, weighed @ residual, left


def missed_by(evidence: Evidence, T_camera_needle: SE3, arc: NeedleArc) -> float:
    """Return how badly a pose explains which rays meet the wire and which pass it; comparable for the same evidence."""
    T = T_camera_needle.inverse()
    missed, entered = np.maximum(closest(evidence.through, T, arc)[0], 0.0), closest(evidence.past, T, arc)[0]
    off = np.concatenate([missed, np.minimum(entered, 0.0)]) / (RAY_SD_PX * evidence.pixel_m)
    return float(np.log1p((off / ROBUST) ** 2).sum())


def unexplained(evidence: Evidence, T_camera_needle: SE3, arc: NeedleArc) -> float:
    """Return the number of rays that contradict a pose, as a share of those that meet steel."""
    T = T_camera_needle.inverse()
    missed, entered = closest(evidence.through, T, arc)[0], closest(evidence.past, T, arc)[0]
    within_m = -0.25 * arc.wire_m
    return float((missed > ASIDE_M).sum() + (entered < within_m).sum()) / max(1, len(missed))


def behind_wire(
    points: NDArray[np.float64], T_needle_camera: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far (n,) points lie behind the wire's front as their rays see it, and how that changes (n, 6).

    It is taken along the rays, as depth scatters, and counted across the wire. A point's distance from the surface
    would not do: what scatters through the thin wire comes out of its back.
    """
    p = T_needle_camera.apply(points)
    ray = p - T_needle_camera.translation_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    angle = arc.behind_tip_rad(p)
    middle, along = arc.point_m(angle), arc.tangent(angle)
    slant = square = back = np.zeros(len(p))
    for _ in range(2):  # to where the ray is nearest to the wire's middle line
        slant = np.sum(ray * along, axis=1)
        gap = p - middle
        square = np.maximum(1.0 - slant**2, STEEP**2)
        back = (np.sum(ray * gap, axis=1) - slant * np.sum(along * gap, axis=1)) / square
        angle = arc.behind_tip_rad(p - back[:, None] * ray)
        middle, along = arc.point_m(angle), arc.tangent(angle)
    aside = np.linalg.norm(p - back[:, None] * ray - middle, axis=1)
    front = np.sqrt(np.maximum((0.5 * arc.wire_m) ** 2 - aside**2, 0.0))
    across = ray - slant[:, None] * along
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    told = (square > STEEP**2) & (angle > 0.0) & (angle < arc.arc_rad)
    behind = back * np.sqrt(square) + front
    by = -np.concatenate([across, np.cross(middle, across)], axis=1)
    return behind[told], np.asarray(by[told], dtype=np.float64)


def closest(
    places: NDArray[np.float64], T_needle_camera: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least distances (n,) along rays from the wire's surface, and their derivatives (n, 6)."""
    if not len(places):
        return np.zeros(0), np.zeros((0, 6))
    local = T_needle_camera.apply(places)
    distance = arc.distance_m(local.reshape(-1, 3)).reshape(local.shape[:2])
    return arc.slopes(local[np.arange(len(local)), distance.argmin(axis=1)])
