"""Find the centres of painted spheres in a colour and depth image (Hwang et al. 2022, IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.geometry.arrays import Array
from trocar.perception.depth import rays_through
from trocar.perception.fiducials import COLORS, Fixture
from trocar.perception.image import RgbdImage

HUE_DEG = 20.0
"""A pixel shows a paint if its hue is this close. The paints are at least 48 deg apart, and noise shifts a hue by a few
deg."""
MIN_SATURATION, MIN_VALUE = 0.45, 0.14  # pixels below these are metal, carbon or dark, where hue means nothing
MIN_PIXELS, MIN_SHARE = 20, 0.15  # number of pixels, and share of a sphere's disc, that must be seen
MIN_GOOD = 0.7  # share of a blob's points that must lie on one sphere; a blob with less shows overlapping spheres
MAX_RMS_M = 0.5e-3  # maximum RMS distance of these points from the sphere; the sensor's noise is .2 mm
RADIUS_OFF_M = 0.6e-3  # maximum difference between a fitted radius and that of the assigned sphere
MAX_POINTS = 300  # number of a blob's points that are fitted; more would not improve the centre
OPENING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
STEPS, DONE_M = 12, 1e-6  # maximum number of Gauss-Newton steps of a fit, and the change at which it ends
LARGEST_M = 0.1  # a larger radius means that the points lie on a plane or a line
GATE_SIGMAS, MIN_GATE_M = 3.0, 0.3e-3
"""A point counts if its distance from the sphere is below this many SDs; the gate never shrinks below the minimum.
Pixels at the rim, between the sphere and what is behind it, are rejected this way."""


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere through points."""

    center_m: Array  # (3,) in the frame of the points
    radius_m: float  # found, or as given
    rms_m: float  # RMS distance of the points that count
    share: float  # share of the points that count

    @property
    def good(self) -> bool:
        """Whether the points lie on one sphere."""
        return self.share >= MIN_GOOD and self.rms_m <= MAX_RMS_M


_Blob = tuple[Array, SphereFit]
"""Points (n, 3) of connected pixels of one colour, and the sphere of free radius through them."""


def find_spheres(image: RgbdImage, fixture: Fixture) -> Array:
    """Return the centres (n, 3) of a fixture's spheres in the camera frame; NaN for those not seen well.

    Pixels are grouped by colour. Blobs of the same colour are told apart by the radius of a sphere fitted to them;
    their centres come from a second fit with the known radius.
    """
    hue, saturation, value = cv2.split(cv2.cvtColor(image.color, cv2.COLOR_RGB2HSV_FULL))
    clear = (saturation >= 255 * MIN_SATURATION) & (value >= 255 * MIN_VALUE) & np.isfinite(image.depth_m)
    hue = np.asarray(hue, dtype=np.uint8)
    centers = np.full((len(fixture.spheres), 3), np.nan)
    for color in {sphere.color: None for sphere in fixture.spheres}:
        wanted = [number for number, sphere in enumerate(fixture.spheres) if sphere.color == color]
        radii_m = fixture.radii_m[wanted]
        away = np.abs((np.arange(256) - _hue(color) + 128) % 256 - 128)
        shows = (away * (360 / 256) <= HUE_DEG).astype(np.uint8)
        blobs = _blobs(image, shows[hue] & clear, float(radii_m.min()))
        for number, (points, rough) in _assigned(blobs, radii_m).items():
            fit = fit_sphere(points, float(radii_m[number]), rough.center_m)
            if fit is not None and fit.good:
                centers[wanted[number]] = fit.center_m
    return centers


def fit_sphere(points_m: Array, radius_m: float | None = None, near_m: Array | None = None) -> SphereFit | None:
    """Return the sphere that fits points (n, 3) seen from the origin; None if none is found.

    Gauss-Newton on the distances from the surface, with outliers rejected at each step. Without ``radius_m``, the
    radius is fitted too; without a guess ``near_m`` (3,), the search for the centre starts behind the points.
    """
    if len(points_m) < 4:
        return None
    free = radius_m is None
    radius = radius_m or 0.5 * float(np.ptp(points_m[:, :2], axis=0).max())
    if near_m is None:
        center = np.median(points_m, axis=0)
        center = center * (1.0 + 0.7 * radius / max(float(np.linalg.norm(center)), 1e-9))  # behind the visible points
    else:
        center = near_m
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
        try:
            step = np.linalg.solve(slopes.T @ slopes, -slopes.T @ residual[used])
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


def _hue(color: str) -> int:
    """Return a paint's hue, 0 to 255."""
    rgb = np.array([[COLORS[color]]], dtype=np.float32)
    return round(float(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)[0, 0, 0]) * 256 / 360) % 256


def _blobs(image: RgbdImage, mask: NDArray[np.uint8], radius_m: float) -> list[_Blob]:
    """Return the blobs in the mask that may be spheres of at least this size."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.morphologyEx(mask, cv2.MORPH_OPEN, OPENING))
    found = []
    for label in range(1, count):
        u, v, wide, high, area = stats[label]
        if area < MIN_PIXELS:
            continue
        window = np.s_[v : v + high, u : u + wide]
        here = labels[window] == label
        depth = image.depth_m[window][here].astype(np.float64)
        disc_px = np.pi * (radius_m * image.intrinsics.fx / np.median(depth)) ** 2
        if area < MIN_SHARE * disc_px:
            continue
        pixels = np.argwhere(here)[:, ::-1] + (u, v)
        some = slice(None, None, 1 + len(pixels) // MAX_POINTS)
        points = rays_through(image.intrinsics, pixels[some]) * depth[some, None]
        rough = fit_sphere(points)
        if rough is not None and rough.good:
            found.append((points, rough))
    return found


def _assigned(blobs: Sequence[_Blob], radii_m: Array) -> dict[int, _Blob]:
    """Return a blob for each sphere (radii of one colour), assigned by size, the best pairs first."""
    off = np.array([[abs(rough.radius_m - radius) for _, rough in blobs] for radius in radii_m])
    chosen: dict[int, _Blob] = {}
    used: set[int] = set()
    for flat in np.argsort(off, axis=None, kind="stable"):
        sphere, blob = divmod(int(flat), len(blobs))
        if sphere not in chosen and blob not in used and off[sphere, blob] <= RADIUS_OFF_M:
            chosen[sphere] = blobs[blob]
            used.add(blob)
    return chosen
