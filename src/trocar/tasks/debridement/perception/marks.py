"""The coloured marks on a gripper's fingers, in both eyes (Kehoe 2014, V-A.2)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms.instrument import FingerMarks
from trocar.perception.color import HueRange
from trocar.perception.image import Intrinsics, StereoImage, StereoRig
from trocar.perception.stereo import triangulate

FARTHEST_M = 0.6
"""A mark farther away than this is too small to be trusted."""
NEAREST_M = 0.08
MIN_SHARE = 0.12
"""Least share of a mark's disc at the greatest distance; smaller spots are noise, or slivers beside what hides the
mark."""
MAX_BLOBS = 4
"""Maximum number of spots of one colour in one picture that are considered, the largest first."""
MAX_MISS_M = 1.2e-3
"""Maximum distance by which the rays to one mark may miss each other; if half of a mark is hidden from one eye, it
shifts this far."""
SPACING_OFF_M = 2.5e-3
"""Maximum error of the distance between a finger's two marks."""


@dataclass(frozen=True, eq=False)
class Blob:
    """A spot of one colour in one picture, or one half of it.

    Attributes:
        middle_px: (2,) u, v of its centroid.
        area_px: number of its pixels.
        merged_px: (n, 2) pixels of the whole spot if this is one half of it: two marks may look like one spot.
    """

    middle_px: NDArray[np.float64]
    area_px: float
    merged_px: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class MarkPair:
    """One mark in both eyes, and where it is: (3,) in the left camera's frame."""

    left: Blob
    right: Blob
    point_m: NDArray[np.float64]


def find_blobs(hsv: NDArray[np.uint8], color: HueRange, lens: Intrinsics, marks: FingerMarks) -> list[Blob]:
    """Return the spots of a colour that may be marks, the largest first; of a single spot, its halves as well."""
    count, labels, stats, middles = cv2.connectedComponentsWithStats(color.mask(hsv), connectivity=4)
    areas = stats[1:count, cv2.CC_STAT_AREA].astype(np.float64)
    least = max(4.0, MIN_SHARE * np.pi * (marks.radius_m * lens.fx / FARTHEST_M) ** 2)
    order = np.argsort(-areas, kind="stable")
    order = order[areas[order] >= least][:MAX_BLOBS]
    blobs = [Blob(middles[1 + k].astype(np.float64), float(areas[k])) for k in order]
    if len(blobs) != 1:
        return blobs
    u, v, wide, high = stats[1 + order[0], :4]
    pixels = np.argwhere(labels[v : v + high, u : u + wide] == 1 + order[0])[:, ::-1] + [u, v]
    return blobs + _halves(pixels.astype(np.float64))


def _halves(pixels: NDArray[np.float64]) -> list[Blob]:
    """Return a spot cut in two across its longest direction."""
    off = pixels - pixels.mean(0)
    along = np.linalg.eigh(off.T @ off)[1][:, -1]
    ahead = off @ along > 0
    return [Blob(pixels[half].mean(0), float(half.sum()), pixels) for half in (ahead, ~ahead) if half.any()]


def pair_blobs(rig: StereoRig, left: list[Blob], right: list[Blob], marks: FingerMarks) -> list[list[MarkPair]]:
    """Return interpretations of a finger's spots, the likeliest first: its two marks, one mark, none.

    Two marks are two pairs of spots whose rays meet, at the known distance; one mark is a whole spot in both eyes.
    """
    pairs, misses = [], []
    for one, other in product(left, right):
        point, miss = triangulate(rig, one.middle_px, other.middle_px)
        if miss <= MAX_MISS_M and NEAREST_M <= point[2] <= FARTHEST_M:
            pairs.append(MarkPair(one, other, point))
            misses.append(float(miss))
    spacing = marks.along_m[1] - marks.along_m[0]
    couples = []
    for a, b in combinations(range(len(pairs)), 2):
        one, two = pairs[a], pairs[b]
        if not (_apart(one.left, two.left) and _apart(one.right, two.right)):
            continue
        off = abs(float(np.linalg.norm(one.point_m - two.point_m)) - spacing)
        if off <= SPACING_OFF_M:
            couples.append((off + misses[a] + misses[b], [one, two]))
    whole = [
        (miss, [pair])
        for miss, pair in zip(misses, pairs, strict=True)
        if pair.left.merged_px is None and pair.right.merged_px is None
    ]
    options = [min(found, key=lambda option: option[0])[1] for found in (couples, whole) if found]
    return [*options, []]


def _apart(one: Blob, other: Blob) -> bool:
    """Return whether two spots can be two marks: a whole spot and a half of it cannot."""
    return one is not other and (one.merged_px is None) == (other.merged_px is None)


def mark_points_m(marks: FingerMarks, tip_length_m: float, jaw_rad: float) -> NDArray[np.float64]:
    """Return the middles (4, 3) of the marks in the tip frame: left finger near and far, right finger near and far."""
    in_finger = np.concatenate([marks.centers_m(side, jaw_rad) for side in (1, -1)])
    return tip_from_finger(in_finger, tip_length_m)


def tip_from_finger(points_m: NDArray[np.float64], tip_length_m: float) -> NDArray[np.float64]:
    """Return points (..., 3) given along the closed finger, out of the closing plane and along the jaw axis."""
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([y, -z, tip_length_m - x], -1)


def mark_colors(marks: FingerMarks) -> tuple[HueRange, HueRange]:
    """Return the colours of the left and the right finger's marks in a picture."""
    return HueRange.around(marks.colors[0]), HueRange.around(marks.colors[1])


def seen_blobs(
    image: StereoImage, hsv: list[NDArray[np.uint8]], marks: FingerMarks
) -> list[tuple[list[Blob], list[Blob]]]:
    """Return for the left and the right finger the spots in the left and in the right picture."""
    lenses = (image.rig.left, image.rig.right)
    return [
        (find_blobs(hsv[0], color, lenses[0], marks), find_blobs(hsv[1], color, lenses[1], marks))
        for color in mark_colors(marks)
    ]
