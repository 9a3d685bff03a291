"""Fit the wrist joints of an instrument to one depth image.

Points on the instrument must lie on its solids, and rays that end far behind it must not have passed through them;
without these rays, a finger could turn into the empty space beside it. The wrist joints are fitted together with a
shift of the whole instrument, due to errors of its base and its outer joints. One image shows little of that shift;
many show a lot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trocar.arms import ArmModel, fk
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.perception.depth import patch_around
from trocar.perception.image import RgbdImage
from trocar.perception.instrument_solids import InstrumentSolids

WINDOW_M = 0.030  # half the edge of the cube about the tip in which the instrument is searched for
NEAR_M = 4e-3  # points this close to the expected instrument count as points on it
BEHIND_M = 0.015  # points this far behind the tip are background
BESIDE_M = 1.6e-3  # background rays that pass this close to the expected instrument show where it is not
COARSE_M, FINE_M = 4e-3, 0.7e-3
"""Spacing in depth at which all background rays are sampled, and where they pass the instrument."""
FINE_STEPS = 6  # number of fine steps on either side of the point where a ray is nearest
INTO_M = 0.1e-3  # rays may pass through an edge this deep, because a pixel averages over its area
POINT_SD_M = 0.3e-3
ROBUST = 1.5  # a residual of more SDs than this counts less (Cauchy)
TOGETHER = 25.0
"""Errors of neighbouring points are correlated: this many points count as one (`benchmarks/bench_sighting.py`)."""
STEPS = 8
MOST_TURN_RAD, MOST_SHIFT_M = 0.1, 0.5e-3  # largest step of the search
START_SD = np.array([0.3, 0.3, 0.3, 1e-3, 1e-3, 1e-3])
"""SDs of wrist (rad) and shift (m) about their expected values; they constrain the search where an image shows
nothing."""
FEWEST = 60  # an instrument with fewer points than this on it was not seen


@dataclass(frozen=True, eq=False)
class Sighting:
    """A normal likelihood of the wrist joints and the shift."""

    q: Array  # (6,) joints about which it was fitted, rad and m; for the wrist, the best fit
    shift_m: Array  # (3,) best-fitting shift of the instrument in its base
    information: Array  # (6, 6) of q4 q5 q6 and the shift, 1/rad and 1/m
    # (6,) gradient of the log likelihood there; 0 except for the effect of the search's prior
    pull: Array
    points: int  # number of points on the instrument
    left_m: float  # robust SD of their distances to its solids


def sight(
    image: RgbdImage, T_base_camera: SE3, arm: ArmModel, q: Array, jaw_rad: float, T_base_floor: SE3 | None = None
) -> Sighting | None:
    """Return the likelihood of the wrist joints given a depth image; None if the instrument is not seen.

    Args:
        image: the depth image.
        T_base_camera: pose of the camera in the arm's base, as registered.
        arm: the arm that carries the instrument.
        q: (6,) expected joints, rad and m.
        jaw_rad: opening between the fingers.
        T_base_floor: a plane, z up; nothing below it is part of the instrument. None: nothing else is near.
    """
    evidence = _gather(image, T_base_camera, arm, q, jaw_rad, T_base_floor)
    if evidence is None:
        return None
    points, rays = evidence
    x, home = np.zeros(6), 1.0 / START_SD**2
    normal, gradient, left = np.eye(6), np.zeros(6), 0.0
    for _ in range(STEPS):
        normal, gradient, left = _normal_equations(arm, q, x, jaw_rad, points, rays)
        step = np.linalg.solve(normal + np.diag(home), -gradient - home * x)
        limit = np.repeat([MOST_TURN_RAD, MOST_SHIFT_M], 3)
        step = np.clip(step, -limit, limit)
        x += step
        if np.abs(step / limit).max() < 1e-2:
            break
    found = q.copy()
    found[3:] += x[:3]
    return Sighting(found, x[3:], normal, home * x, len(points), left)


def _gather(
    image: RgbdImage, T_base_camera: SE3, arm: ArmModel, q: Array, jaw_rad: float, T_base_floor: SE3 | None
) -> tuple[Array, Array] | None:
    """Return points (n, 3) on the instrument and points (m, k, 3) along rays that pass it, in the arm's base."""
    p_tip = fk(arm, q).translation_m
    T_camera_tip = T_base_camera.inverse() @ SE3.from_parts(translation_m=p_tip)
    patch = patch_around(image, T_camera_tip, np.full(3, -WINDOW_M), np.full(3, WINDOW_M))
    if patch is None:
        return None
    known = np.isfinite(patch.depth_m)
    rays, depth = patch.rays[known], patch.depth_m[known]
    points = T_base_camera.apply(rays * depth[:, None])
    on = np.linalg.norm(points - p_tip, axis=1) < WINDOW_M
    if T_base_floor is not None:
        on &= T_base_floor.inverse().apply(points)[:, 2] > 0.0
    solids = InstrumentSolids.of(arm, q, jaw_rad)
    on[on] = solids.distance_m(points[on]) < NEAR_M
    if on.sum() < FEWEST:
        return None
    tip_m = float(T_camera_tip.translation_m[2])
    past = rays[depth > tip_m + BEHIND_M]
    along = np.tile(tip_m + np.arange(-0.5 * WINDOW_M, BEHIND_M, COARSE_M), (len(past), 1))
    for within in (BESIDE_M + 0.5 * COARSE_M, BESIDE_M):
        followed = T_base_camera.apply(past[:, None] * along[..., None])
        distance = solids.distance_m(followed.reshape(-1, 3)).reshape(along.shape)
        past, along, distance = (a[distance.min(axis=1) < within] for a in (past, along, distance))
        nearest = along[np.arange(len(along)), distance.argmin(axis=1)]
        along = nearest[:, None] + FINE_M * np.arange(-FINE_STEPS, FINE_STEPS + 1)
    followed = T_base_camera.apply(past[:, None] * along[..., None])
    if T_base_floor is not None and len(followed):
        followed = followed[(T_base_floor.inverse().apply(followed)[..., 2] > 0.0).all(axis=1)]
    return points[on], followed


def _normal_equations(
    arm: ArmModel, q: Array, x: Array, jaw_rad: float, points: Array, rays: Array
) -> tuple[Array, Array, float]:
    """Return the cost's information (6, 6) and gradient (6,) at a change of wrist and shift (6,), and the robust SD."""
    turned = q.copy()
    turned[3:] += x[:3]
    solids = InstrumentSolids.of(arm, turned, jaw_rad)
    distance, slopes = solids.slopes(points - x[3:])
    left = float(1.48 * np.median(np.abs(distance)))
    if len(rays):
        shifted = rays - x[3:]
        nearest = solids.distance_m(shifted.reshape(-1, 3)).reshape(rays.shape[:2]).argmin(axis=1)
        passed, by = solids.slopes(shifted[np.arange(len(rays)), nearest])
        into = np.minimum(passed + INTO_M, 0.0)
        distance = np.concatenate([distance, into])
        slopes = np.concatenate([slopes, np.where(into[:, None] < 0.0, by, 0.0)])
    residual, slopes = distance / POINT_SD_M, slopes / POINT_SD_M
    weighed = slopes.T / (1.0 + (residual / ROBUST) ** 2) / TOGETHER
    return weighed @ slopes, weighed @ residual, left
