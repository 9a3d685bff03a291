"""From a colour and depth image to the centres of painted spheres (Hwang et al. 2022, IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.perception.depth import check_image, rays_through
from trocar.perception.fiducials.fixture import COLORS, Fixture
from trocar.perception.fiducials.sphere_fit import SphereFit, fit_sphere
from trocar.perception.image import RgbdImage

HUE_DEG = 20.0
"""A pixel shows a paint if its hue is this close; the paints are at least 48 deg apart, and noise shifts a hue by some
deg."""
MIN_SATURATION, MIN_VALUE = 0.45, 0.14
"""Pixels below these are metal, carbon or dark, where hue means nothing."""
MIN_SHARE = 0.15
"""Share of a sphere's disc that must be seen."""
MIN_GOOD = 0.7
"""Share of a patch's points that must lie on one sphere; with less, it is two spheres behind each other."""
MAX_RMS_M = 0.5e-3
"""Maximum RMS distance of these points from the sphere; the sensor's noise is .2 mm."""
RADIUS_OFF_M = 0.6e-3
"""Maximum difference between a fitted radius and that of the assigned sphere."""
MAX_POINTS = 300
"""Number of a patch's points that are fitted; more would not improve the centre."""
OPENING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


@dataclass(frozen=True, eq=False)
class _Patch:
    """Connected pixels of one colour with depth, and the sphere of free radius through them."""

    points_m: NDArray[np.float64]
    rough: SphereFit


def find_spheres(image: RgbdImage, fixture: Fixture) -> NDArray[np.float64]:
    """Return the centres (n, 3) of a fixture's spheres in the camera frame; NaN for those not seen well.

    Pixels are grouped by colour; patches of the same colour are distinguished by the radius of the sphere through them;
    the centre is then fitted with the known radius.

    Raises:
        TrocarError: the arrays of the image do not match its camera.
    """
    check_image(image)
    hsv = cv2.cvtColor(image.color, cv2.COLOR_RGB2HSV_FULL)
    clear = (hsv[..., 1] >= 255 * MIN_SATURATION) & (hsv[..., 2] >= 255 * MIN_VALUE) & np.isfinite(image.depth_m)
    centers = np.full((len(fixture.spheres), 3), np.nan)
    for color in {sphere.color: None for sphere in fixture.spheres}:
        wanted = [number for number, sphere in enumerate(fixture.spheres) if sphere.color == color]
        away = np.abs((hsv[..., 0].astype(np.int16) - _hue(color) + 128) % 256 - 128)
        mask = (clear & (away * (360 / 256) <= HUE_DEG)).astype(np.uint8)
        patches = _patches(image, mask, float(fixture.radii_m[wanted].min()))
        for number, patch in _assigned(patches, fixture.radii_m[wanted]).items():
            centers[wanted[number]] = _center(patch, float(fixture.radii_m[wanted[number]]))
    return centers


def _hue(color: str) -> int:
    """Return a paint's hue, 0 to 255."""
    rgb = np.array([[COLORS[color]]], dtype=np.float32)
    return round(float(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)[0, 0, 0]) * 256 / 360) % 256


def _patches(image: RgbdImage, mask: NDArray[np.uint8], radius_m: float) -> list[_Patch]:
    """Return the patches in the mask that may be spheres of at least this size."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.morphologyEx(mask, cv2.MORPH_OPEN, OPENING))
    found = []
    for label in range(1, count):
        u, v, wide, high, area = stats[label]
        if area < 20:  # noise
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
        if rough is not None and rough.share >= MIN_GOOD and rough.rms_m <= MAX_RMS_M:
            found.append(_Patch(points, rough))
    return found


def _assigned(patches: Sequence[_Patch], radii_m: NDArray[np.float64]) -> dict[int, _Patch]:
    """Assign patches of a colour to spheres by size, the best pairs first; each is used once."""
    off = np.array([[abs(patch.rough.radius_m - radius) for patch in patches] for radius in radii_m])
    chosen: dict[int, _Patch] = {}
    used: set[int] = set()
    for flat in np.argsort(off, axis=None, kind="stable"):
        sphere, patch = divmod(int(flat), len(patches))
        if sphere not in chosen and patch not in used and off[sphere, patch] <= RADIUS_OFF_M:
            chosen[sphere] = patches[patch]
            used.add(patch)
    return chosen


def _center(patch: _Patch, radius_m: float) -> NDArray[np.float64]:
    fit = fit_sphere(patch.points_m, radius_m, patch.rough.center_m)
    good = fit is not None and fit.share >= MIN_GOOD and fit.rms_m <= MAX_RMS_M
    return fit.center_m if fit is not None and good else np.full(3, np.nan)
