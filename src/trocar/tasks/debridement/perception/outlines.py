"""Outlines of convex objects that may touch, or partly hide each other."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

ACROSS = 0.15
"""Least distance along the outline between the ends of a cut, as a share of the outline's length."""
CUT_PX = 2


def split_convex(mask: NDArray[np.uint8], notch_px: float, least_px: float) -> list[NDArray[np.uint8]]:
    """Return the parts of a mask (h, w), cut between its notches until each is roughly convex; 255 inside a part.

    Convex objects whose outlines overlap leave notches where they meet. A cut goes from the deepest notch to the
    nearest other one of similar depth, or straight across.

    Args:
        mask: 255 inside the objects, one connected piece or several.
        notch_px: depth from which on a notch counts.
        least_px: area of a part; a cut that would leave less is not made.
    """
    parts: list[NDArray[np.uint8]] = []
    rest = _pieces(mask, least_px)
    while rest:
        part = rest.pop()
        cut = _cut(part, notch_px)
        halves = [] if cut is None else _pieces(cut, least_px)
        if len(halves) > 1:
            rest += [_grown(half) & part for half in halves]
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
    return len(u) / max(1, int(np.count_nonzero(hull)))


def _pieces(mask: NDArray[np.uint8], least_px: float) -> list[NDArray[np.uint8]]:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    return [
        np.where(labels == k, 255, 0).astype(np.uint8)
        for k in range(1, count)
        if stats[k, cv2.CC_STAT_AREA] >= least_px
    ]


def _grown(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Restore the pixels that the cut removed."""
    return np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)), dtype=np.uint8)


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
