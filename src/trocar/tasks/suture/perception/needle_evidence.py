"""What depth images show of a needle whose pose is roughly known: points on its wire, rays that meet or pass it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.geometry import SE3
from trocar.perception.depth import Patch, patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.suture.needle import Needle

MARGIN_M = 2.5e-3
"""At least so much about the needle is read: the floor's colour is taken from there."""
BEHIND_M = 1.5e-3
"""A ray that ends this far behind the wire passed it."""
OVER_FLOOR_M = 0.7e-3
"""Points lower than this over the floor are not on a needle."""
ON_FLOOR_M = 1.0e-3
"""Points this close to the floor show its colour."""
APART_M = 1.0e-3
"""Points this close to another known object may be on that object."""
IN_FRONT_M = 1.5e-3
"""A point this much nearer than the wire can be hides it."""
STEP_M, COARSE = 1.5e-3, 5
BEFORE_M = np.arange(-0.08, 0.004, STEP_M)
"""Positions along a ray, relative to where it is nearest to the wire, at which another object would hide the wire or be
taken for it. One in this many is tried first."""
UNLIKE = 0.05
"""Colours whose shares of red, green and blue differ by more are not the same."""
GREY = 0.25
"""Steel has less saturation."""
DARK = 0.12
"""Pixels with less than this share of the floor's light are in shadow and show no colour."""
SPACING_M, WIRE_SPACING_M = 0.4e-3, 0.1e-3
"""Spacing at which rays and the wire are sampled."""
FEWEST, DEEP = 12, 0.4
"""Minimum number of pixels on the wire for it to count as seen, and the share of them that must have depth in each
image."""

Distances = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signed distances (n,) of points (n, 3) in the camera's frame from other known objects."""


@dataclass(frozen=True, eq=False)
class NeedleEvidence:
    """The evidence of images, in the camera's frame.

    Attributes:
        points: (n, 3) on the wire.
        through: (m, k, 3) positions along rays that meet it.
        past: (l, k, 3) positions along rays that pass it.
        pixel_m: distance of neighbouring rays there.
    """

    points: NDArray[np.float64]
    through: NDArray[np.float64]
    past: NDArray[np.float64]
    pixel_m: float


def gather_evidence(
    images: Sequence[RgbdImage],
    T_camera_needle: SE3,
    needle: Needle,
    near_m: float,
    T_camera_floor: SE3,
    occluders: Distances | None,
    every: int,
) -> NeedleEvidence | None:
    """Return what images show of a needle near this pose; None if it is too little.

    Colours are taken from the first image, since the others have the same. One in ``every`` rows and columns is read.
    """
    half = np.array([needle.radius_m, needle.radius_m, 0.0]) + 0.5 * needle.wire_m + max(near_m, MARGIN_M)
    patches = [
        patch.thinned(every)
        for image in images
        if (patch := patch_around(image, T_camera_needle, -half, half)) is not None
    ]
    if not patches:
        return None
    T_needle, T_floor = T_camera_needle.inverse(), T_camera_floor.inverse()
    rays = patches[0].rays.reshape(-1, 3)
    z_near, beside = along_rays(rays, T_camera_needle, needle, near_m)
    ours = beside < near_m
    ours[ours] = T_floor.apply(rays[ours] * z_near[ours, None])[:, 2] > OVER_FLOOR_M
    depth = np.array([patch.depth_m.ravel() for patch in patches])
    ours &= np.nan_to_num(depth, nan=np.inf).min(axis=0) >= z_near - near_m - IN_FRONT_M
    if occluders is not None:
        ours[ours] = clear(occluders, rays[ours], z_near[ours])
    shows_floor, shows_steel = colors(patches[0], T_floor)
    through = ours & shows_steel
    if through.sum() < FEWEST:
        return None
    points = (rays * depth[..., None])[:, through].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    on = (needle.distance_m(T_needle.apply(points)) < near_m) & (T_floor.apply(points)[:, 2] > OVER_FLOOR_M)
    if on.sum() < FEWEST * DEEP:
        return None
    past = ours & ~shows_steel & (shows_floor | (depth[0] > z_near + BEHIND_M))
    places = rays[:, None] * (z_near[:, None] + np.arange(-4, 5) * SPACING_M)[..., None]
    pixel_m = every * float(T_camera_needle.translation_m[2]) / images[0].intrinsics.fx
    return NeedleEvidence(points[on], places[through], places[past], pixel_m)


def along_rays(
    rays: NDArray[np.float64], T_camera_needle: SE3, needle: Needle, near_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the depth (n,) of the wire where rays (n, 3) are nearest to it, and their least distances (n,) from it.

    Rays that pass it further away than ``near_m`` have an infinite distance.
    """
    count = 2 + int(needle.radius_m * needle.arc_rad / WIRE_SPACING_M)
    wire = T_camera_needle.apply(needle.point_m(np.linspace(0.0, needle.arc_rad, count)))
    farthest = (near_m + 0.5 * needle.wire_m) / wire[:, 2].min()
    apart, place = KDTree(wire[:, :2] / wire[:, 2:]).query(rays[:, :2], distance_upper_bound=farthest)
    depth = wire[np.minimum(place, count - 1), 2]
    return depth, depth * apart - 0.5 * needle.wire_m


def clear(occluders: Distances, rays: NDArray[np.float64], z_near: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rays (n, 3) reach these depths (n,) and a little further without meeting another object."""

    def least(which: NDArray[np.intp], before_m: NDArray[np.float64]) -> NDArray[np.float64]:
        along = rays[which, None] * (z_near[which, None] + before_m)[..., None]
        return occluders(along.reshape(-1, 3)).reshape(along.shape[:2]).min(axis=1)

    roughly = least(np.arange(len(rays)), BEFORE_M[::COARSE])
    clear = roughly > APART_M
    # A distance changes by no more than the way along the ray: only near something the places between have to be tried.
    unsure = np.flatnonzero(clear & (roughly < APART_M + COARSE * STEP_M))
    clear[unsure] = least(unsure, BEFORE_M) > APART_M
    return clear


def colors(patch: Patch, T_floor_camera: SE3) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which pixels (n,) have the floor's colour, and which are of steel."""
    color = patch.color.reshape(-1, 3).astype(np.float64)
    light = color.sum(axis=1)
    share = color / np.maximum(light, 1.0)[:, None]
    floor = np.abs(T_floor_camera.apply(patch.points_m.reshape(-1, 3))[:, 2]) < ON_FLOOR_M
    if not floor.any():
        return np.zeros(len(color), dtype=bool), np.zeros(len(color), dtype=bool)
    like = np.abs(share - np.median(share[floor], axis=0)).max(axis=1) < UNLIKE
    lit = light > DARK * np.median(light[floor])
    grey = np.ptp(color, axis=1) < GREY * color.max(axis=1)
    return lit & like, lit & ~like & grey
