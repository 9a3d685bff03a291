"""Red objects in both pictures of a pair: paired, and cut where convex ones overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.perception.image import StereoRig

MIN_AREA_M2 = 3e-6  # least visible area of a fragment, at the table; smaller spots are noise
OVERLAP = 0.25  # regions whose overlap is a larger share of the smaller one show the same object
ROW_PX = 0.012
"""Maximum difference in rows between the middles of one object (when half hidden), as a share of the focal length."""
HIGHEST_M = 0.15  # maximum height above the table at which fragments are carried
ACROSS = 0.15  # least distance along the outline between the ends of a cut, as a share of the outline's length
CUT_PX = 2
CLOSING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True, eq=False)
class Region:
    """One object as seen by one eye."""

    mask: NDArray[np.uint8]  # (h, w) 255 where it is, in a rectangle of the picture; not empty
    corner_px: tuple[int, int]  # (u, v) of this rectangle's first pixel
    pieces: int = 1  # number of pieces in which it is seen

    @cached_property
    def middle_px(self) -> NDArray[np.float64]:
        """Return its centroid (2,) u, v."""
        v, u = np.nonzero(self.mask)
        return np.array([u.mean(), v.mean()]) + self.corner_px

    @cached_property
    def area_px(self) -> float:
        """Return the number of its pixels."""
        return float(np.count_nonzero(self.mask))

    @property
    def hull_px(self) -> NDArray[np.float64]:
        """Return the corners (n, 2) of its convex hull."""
        v, u = np.nonzero(self.mask)
        hull = cv2.convexHull(np.column_stack([u, v]).astype(np.int32))[:, 0]
        return hull.astype(np.float64) + self.corner_px

    @property
    def hull_middle_px(self) -> NDArray[np.float64]:
        """Return the centroid (2,) of its convex hull."""
        moments = cv2.moments((self.hull_px - self.corner_px).astype(np.float32))
        if moments["m00"] < 1.0:
            return self.middle_px
        return np.array([moments["m10"], moments["m01"]]) / moments["m00"] + self.corner_px

    def united(self, right: Region, disparity_px: float) -> Region:
        """Return the union of this left region and a right one shifted by a disparity."""
        (u0, v0), (u1, v1) = self.corner_px, (right.corner_px[0] + round(disparity_px), right.corner_px[1])
        (high0, wide0), (high1, wide1) = self.mask.shape, right.mask.shape
        u, v = min(u0, u1), min(v0, v1)
        size = max(v0 + high0, v1 + high1) - v, max(u0 + wide0, u1 + wide1) - u
        canvas = Region(np.zeros(size, np.uint8), (u, v))
        mask = shifted_onto(canvas, self, 0) | shifted_onto(canvas, right, disparity_px)
        return Region(mask, (u, v), max(self.pieces, right.pieces))


def shifted_onto(base: Region, other: Region, disparity_px: float) -> NDArray[np.uint8]:
    """Return another region's mask in the rectangle of this one, shifted by this much to the right."""
    result = np.zeros_like(base.mask)
    du = other.corner_px[0] + round(disparity_px) - base.corner_px[0]
    dv = other.corner_px[1] - base.corner_px[1]
    (high, wide), (h, w) = base.mask.shape, other.mask.shape
    u0, u1, v0, v1 = max(du, 0), min(du + w, wide), max(dv, 0), min(dv + h, high)
    if u1 > u0 and v1 > v0:
        result[v0:v1, u0:u1] = other.mask[v0 - dv : v1 - dv, u0 - du : u1 - du]
    return result


def plane_disparity(rig: StereoRig, T_table_camera: SE3, height_m: float) -> NDArray[np.float64]:
    """Return a, b, c of the disparity a u + b v + c in px at which a rectified pair sees a plane above the table."""
    lens, baseline = rig.left, float(rig.T_left_right.translation_m[0])
    normal = T_table_camera.rotation.matrix[2]  # the table's z in the camera
    distance = float(height_m - T_table_camera.translation_m[2])
    per_depth = lens.fx * baseline * normal / distance
    a, b = per_depth[0] / lens.fx, per_depth[1] / lens.fy
    c = per_depth[2] - a * lens.cx - b * lens.cy + (rig.left.cx - rig.right.cx)
    return np.array([a, b, c])


def group_regions(
    masks: Sequence[NDArray[np.uint8]], rig: StereoRig, T_table_camera: SE3, height_m: float
) -> list[tuple[Region, Region]]:
    """Return the objects that both eyes of a rectified pair see.

    Objects on the table appear at the same place once the right picture is shifted by the disparity of a height above
    the table; this joins the pieces of an object that is split in one eye. Objects higher up are paired by rows.
    """
    least = MIN_AREA_M2 * rig.left.fx**2 / T_table_camera.translation_m[2] ** 2 / 2
    labels = [_labelled(mask, least) for mask in masks]
    a, b, c = plane_disparity(rig, T_table_camera, height_m)
    shape = masks[0].shape[::-1]
    onto_left = np.array([[1 - a, -b, -c], [0.0, 1.0, 0.0]])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    shifted = cv2.warpAffine(labels[1].astype(np.int16), onto_left, shape, flags=flags)
    groups = _linked(labels[0], shifted.astype(np.int32))
    found = [(_region(labels[0], lefts), _region(labels[1], rights)) for lefts, rights in groups if lefts and rights]
    alone_left = [_region(labels[0], lefts) for lefts, rights in groups if not rights]
    alone_right = [_region(labels[1], rights) for lefts, rights in groups if not lefts]
    return found + _paired_by_row(alone_left, alone_right, rig, (a, b, c), T_table_camera)


def _labelled(mask: NDArray[np.uint8], least_px: float) -> NDArray[np.int32]:
    """Return the number of each pixel's region, from 1 on; 0 for none. Holes from specular spots are filled."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, CLOSING)
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    labels = np.zeros(mask.shape, dtype=np.int32)
    number = 0
    for contour in contours:
        if cv2.contourArea(contour) >= least_px:
            number += 1
            cv2.drawContours(labels, [contour], -1, number, cv2.FILLED)
    return labels


def _linked(left: NDArray[np.int32], right: NDArray[np.int32]) -> list[tuple[list[int], list[int]]]:
    """Return groups of regions (left numbers, right numbers) that overlap."""
    counts = [np.bincount(labels.ravel(), minlength=1) for labels in (left, right)]
    n, m = len(counts[0]), max(len(counts[1]), int(right.max()) + 1)
    common = np.bincount((left * m + right)[(left > 0) & (right > 0)].ravel(), minlength=n * m).reshape(n, m)
    groups: list[tuple[list[int], list[int]]] = []
    seen = np.zeros(m, dtype=bool)
    for i in range(1, n):
        rights = [j for j in range(1, len(counts[1])) if common[i, j] > OVERLAP * min(counts[0][i], counts[1][j])]
        seen[rights] = True
        joined = [group for group in groups if set(group[1]) & set(rights)]
        merged = ([i], rights)
        for group in joined:
            groups.remove(group)
            merged = (group[0] + merged[0], sorted({*group[1], *merged[1]}))
        groups.append(merged)
    return groups + [([], [j]) for j in range(1, m) if not seen[j]]


def _region(labels: NDArray[np.int32], numbers: Sequence[int]) -> Region:
    here = np.isin(labels, numbers) if len(numbers) > 1 else labels == numbers[0]
    rows, columns = np.flatnonzero(here.any(1)), np.flatnonzero(here.any(0))
    v, u = int(rows[0]), int(columns[0])
    mask = np.where(here[v : rows[-1] + 1, u : columns[-1] + 1], 255, 0).astype(np.uint8)
    return Region(mask, (u, v), len(numbers))


def _paired_by_row(
    lefts: Sequence[Region],
    rights: Sequence[Region],
    rig: StereoRig,
    plane: tuple[float, float, float],
    T_table_camera: SE3,
) -> list[tuple[Region, Region]]:
    """Return pairs of regions above the table: in the same rows, of similar size, not too close to the eyes."""
    found = []
    rest = list(rights)
    far = T_table_camera.translation_m[2]
    for left in sorted(lefts, key=lambda region: -region.area_px):
        lying = float(plane[0] * left.middle_px[0] + plane[1] * left.middle_px[1] + plane[2])
        nearest = lying * far / max(far - HIGHEST_M, 0.05)
        fits = []
        for right in rest:
            disparity = left.middle_px[0] - right.middle_px[0]
            rows = abs(left.middle_px[1] - right.middle_px[1])
            alike = min(left.area_px, right.area_px) / max(left.area_px, right.area_px)
            if lying - 8 <= disparity <= nearest and rows <= ROW_PX * rig.left.fy and alike > 0.4:
                fits.append((rows + 20 * (1 - alike), right))
        if fits:
            _, best = min(fits, key=lambda fit: fit[0])
            found.append((left, best))
            rest = [right for right in rest if right is not best]
    return found


def split_convex(mask: NDArray[np.uint8], notch_px: float, least_px: float) -> list[NDArray[np.uint8]]:
    """Return the parts of a mask (h, w), cut between its notches until each is roughly convex; 255 inside a part.

    Convex objects whose outlines overlap leave notches where they meet. A cut goes from the deepest notch to the
    nearest other one of similar depth, or straight across. Notches less deep than ``notch_px`` do not count, and no cut
    leaves a part of less than ``least_px``.
    """
    parts: list[NDArray[np.uint8]] = []
    rest = _pieces(mask, least_px)
    while rest:
        part = rest.pop()
        cut = _cut(part, notch_px)
        halves = [] if cut is None else _pieces(cut, least_px)
        if len(halves) > 1:
            # with the pixels that the cut removed
            rest += [np.asarray(cv2.dilate(half, np.ones((3, 3), np.uint8)), np.uint8) & part for half in halves]
        else:
            parts.append(part)
    return parts


def solidity(mask: NDArray[np.uint8]) -> float:
    """Return the share of its convex hull that a mask fills."""
    v, u = np.nonzero(mask)
    if len(u) < 3:
        return 1.0
    hull = np.zeros_like(mask)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.column_stack([u, v]).astype(np.int32)), 255)
    return len(u) / int(np.count_nonzero(hull))


def _pieces(mask: NDArray[np.uint8], least_px: float) -> list[NDArray[np.uint8]]:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    large = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= least_px]
    return [np.where(labels == k, 255, 0).astype(np.uint8) for k in large]


def _cut(mask: NDArray[np.uint8], notch_px: float) -> NDArray[np.uint8] | None:
    """Return the mask with one cut through it, or None if it has no notch."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)
    hull = cv2.convexHull(outline, returnPoints=False)
    if len(outline) < 8 or len(hull) < 4:
        return None
    defects = cv2.convexityDefects(outline, np.sort(hull, axis=0)[::-1])
    if defects is None:
        return None
    defects = defects.reshape(-1, 4)
    depth, place = defects[:, 3] / 256.0, defects[:, 2].astype(np.intp)
    deepest = int(np.argmax(depth))
    if depth[deepest] < notch_px:
        return None
    begin = int(place[deepest])
    points = outline[:, 0].astype(np.float64)
    steps = np.abs(np.arange(len(points)) - begin)
    far = np.minimum(steps, len(points) - steps) >= ACROSS * len(points)
    notches = place[(depth > 0.5 * depth[deepest]) & far[place]]
    ends = notches if len(notches) else np.flatnonzero(far)
    end = int(ends[np.argmin(np.linalg.norm(points[ends] - points[begin], axis=-1))])
    cut = mask.copy()
    cv2.line(cut, outline[begin, 0].tolist(), outline[end, 0].tolist(), 0, CUT_PX)
    return cut
