"""Pixels to rays, depth images to points, and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.perception.image import Intrinsics, RgbdImage

UNDISTORT_STEPS = 40
UNDISTORT_DONE = 1e-14
"""Maximum number of fixed-point steps, and the change at which they end; the paper's camera needs fewer than 30."""


def distort(intrinsics: Intrinsics, normalised: Array) -> Array:
    """Return the distorted x/z, y/z (..., 2) by Brown's lens model (OpenCV: k1 k2 p1 p2 k3)."""
    k1, k2, p1, p2, k3 = intrinsics.distortion
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([u, v], -1)


def undistort(intrinsics: Intrinsics, distorted: Array) -> Array:
    """Return the x/z, y/z (..., 2) that the lens maps to ``distorted`` (fixed-point iteration)."""
    k1, k2, p1, p2, k3 = intrinsics.distortion
    point = distorted.copy()
    for _ in range(UNDISTORT_STEPS if any(intrinsics.distortion) else 0):
        x, y = point[..., 0], point[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)
        before, point = point, (distorted - shift) / radial[..., None]
        if (np.abs(point - before) < UNDISTORT_DONE).all():
            break
    return point


@lru_cache(maxsize=16)  # for whole images and for the windows that a suture task looks at
def pixel_rays(intrinsics: Intrinsics) -> Array:
    """Return the direction (height, width, 3) of each pixel in the camera frame, scaled to z = 1."""
    pixels = np.stack(np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height)), -1)
    rays = rays_through(intrinsics, pixels)
    rays.setflags(write=False)
    return rays


def rays_through(intrinsics: Intrinsics, pixels: ArrayLike) -> Array:
    """Return the directions (..., 3) in the camera frame, scaled to z = 1, through pixels (..., 2) u, v."""
    u, v = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
    flat = np.stack([(u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy], -1)
    return np.concatenate([undistort(intrinsics, flat), np.ones((*flat.shape[:-1], 1))], -1)


def project(intrinsics: Intrinsics, points_m: ArrayLike) -> Array:
    """Return the pixels (..., 2) u, v of points (..., 3) in the camera frame; NaN for points behind the camera."""
    p = np.asarray(points_m, dtype=np.float64)
    z = np.where(p[..., 2:] > 0, p[..., 2:], np.nan)
    focal, middle = [intrinsics.fx, intrinsics.fy], [intrinsics.cx, intrinsics.cy]
    return distort(intrinsics, p[..., :2] / z) * focal + middle


@dataclass(frozen=True, eq=False)
class Patch:
    """A rectangle of an image, with the rays of its pixels."""

    rays: Array  # (m, n, 3) directions in the camera frame, z = 1
    depth_m: Array  # (m, n) along the optical axis, NaN where it is unknown
    color: NDArray[np.uint8]  # (m, n, 3) uint8 RGB

    @property
    def points_m(self) -> Array:
        """Return the points (m, n, 3) in the camera frame, NaN where there is no depth."""
        return self.rays * self.depth_m[..., None]

    def thinned(self, every: int) -> Patch:
        """Return the patch with only every ``every``-th row and column."""
        some = np.s_[::every, ::every]
        return Patch(self.rays[some], self.depth_m[some], self.color[some])


def patch_around(image: RgbdImage, T_camera_box: SE3, lower_m: ArrayLike, upper_m: ArrayLike) -> Patch | None:
    """Return the pixels that a box covers, given by two corners (3,) in its own frame; None if it is not seen."""
    lower, upper = np.asarray(lower_m, dtype=np.float64), np.asarray(upper_m, dtype=np.float64)
    pick = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
    pixel = project(image.intrinsics, T_camera_box.apply(np.where(pick, upper, lower)))
    if not np.isfinite(pixel).all():
        return None
    u0, v0 = np.maximum(np.floor(pixel.min(0)).astype(int), 0)
    u1 = min(int(pixel[:, 0].max()) + 2, image.intrinsics.width)
    v1 = min(int(pixel[:, 1].max()) + 2, image.intrinsics.height)
    if u1 - u0 < 2 or v1 - v0 < 2:
        return None
    window = np.s_[v0:v1, u0:u1]
    return Patch(pixel_rays(image.intrinsics)[window], image.depth_m[window].astype(np.float64), image.color[window])
