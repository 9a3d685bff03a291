"""Find a needle that lies flat on the phantom, from one depth image.

The needle's ends look alike, so an image tells neither which end is the tip nor which face of the needle is up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, TURN
from trocar.perception.depth import patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.suture.needle import Needle
from trocar.tasks.suture.perception import colors

LOW_M = 3.0e-3
"""Steel higher than this over the floor does not belong to a needle that lies flat."""
TRIES, SEED = 400, 3
"""Number of pairs of pixels that are tried as two points of the wire, and the seed that draws them."""
ON_WIRE_M = 0.8e-3
"""Pixels this close to the wire's centreline show it."""
FEWEST, SHARE = 60, 0.7
"""Least number of pixels that show the wire, and their least share of all steel within the needle's circle."""
ARC_RAD = math.radians(25.0)
"""Largest difference between the arc that is seen and the needle's."""


@dataclass(frozen=True, eq=False)
class LyingNeedle:
    """A needle that lies flat.

    Attributes:
        center_m: (2,) centre of its arc, in the floor's frame.
        pixels: number of pixels that show it.
    """

    center_m: NDArray[np.float64]
    pixels: int


def find_lying(
    image: RgbdImage, T_camera_floor: SE3, half_m: tuple[float, float], needle: Needle
) -> LyingNeedle | None:
    """Return where a needle lies on a floor; None if none is seen, or something hides a part of it.

    Args:
        image: an image with depth.
        T_camera_floor: pose of the floor, z up, origin in its middle.
        half_m: half of the floor's size along its x and y.
        needle: the needle's shape.
    """
    patch = patch_around(image, T_camera_floor, [-half_m[0], -half_m[1], 0.0], [half_m[0], half_m[1], LOW_M])
    if patch is None:
        return None
    T_floor_camera = T_camera_floor.inverse()
    steel = colors(patch, T_floor_camera)[1]
    low = T_floor_camera.apply(patch.points_m.reshape(-1, 3)[steel])[:, 2] < LOW_M
    rays = T_floor_camera.rotation.apply(patch.rays.reshape(-1, 3)[steel][low])
    eye = T_floor_camera.translation_m  # rays are cut with the plane of the wire's centreline
    places = (eye + rays * ((needle.wire_m / 2 - eye[2]) / rays[:, 2])[:, None])[:, :2]
    places = places[(np.abs(places) < half_m).all(1)]
    center = _center(places, needle.radius_m)
    if center is None:
        return None
    away = np.linalg.norm(places - center, axis=1)
    wire = places[np.abs(away - needle.radius_m) < ON_WIRE_M] - center
    if len(wire) < max(FEWEST, SHARE * (away < needle.radius_m + ON_WIRE_M).sum()):
        return None
    angles = np.sort(np.arctan2(wire[:, 1], wire[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + TURN))
    if abs(TURN - gaps.max() - needle.arc_rad) > ARC_RAD:
        return None
    return LyingNeedle(center, len(wire))


def _center(places_m: NDArray[np.float64], radius_m: float) -> NDArray[np.float64] | None:
    """Return the centre (2,) of the circle of this radius through most places (n, 2); None if there is none."""
    if len(places_m) < FEWEST:
        return None
    pairs = places_m[np.random.default_rng(SEED).integers(len(places_m), size=(TRIES, 2))]
    chord = pairs[:, 1] - pairs[:, 0]
    length = np.linalg.norm(chord, axis=1)
    fit = (length > radius_m / 2) & (length < 2 * radius_m)
    chord, length, middle = chord[fit], length[fit], pairs[fit].mean(1)
    # two circles of the radius pass through each pair of places
    across = np.column_stack([-chord[:, 1], chord[:, 0]]) / length[:, None]
    up_m = np.sqrt(radius_m**2 - (length / 2) ** 2)[:, None]
    centers = np.concatenate([middle + up_m * across, middle - up_m * across])
    if not len(centers):
        return None
    off = np.abs(np.linalg.norm(places_m[None] - centers[:, None], axis=2) - radius_m) < ON_WIRE_M
    center = centers[int(np.argmax(off.sum(1)))]
    for _ in range(5):  # least squares over the places on the wire
        away = places_m - center
        distance = np.linalg.norm(away, axis=1)
        near = np.abs(distance - radius_m) < ON_WIRE_M
        toward = away[near] / distance[near, None]
        center = center + np.linalg.lstsq(toward, distance[near] - radius_m, rcond=None)[0]
    return center
