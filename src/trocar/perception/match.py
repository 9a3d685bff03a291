"""Disparity of textured surfaces in a rectified pair: normalised cross-correlation, finer than a pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_CORRELATION = 0.6
"""A window with less correlation counts as not found."""
AGREE_PX = 1.0
"""Maximum difference between the disparities found from the right and from the left picture."""
FLAT = 1.0
"""Variance of noise alone, in squared grey levels; windows with no more than that match anything."""


def disparity_map(
    left: NDArray,
    right: NDArray,
    box_px: tuple[int, int, int, int],
    disparity_px: tuple[float, float],
    window_px: int = 9,
) -> NDArray[np.float64]:
    """Return the disparity (h, w) of the left pixels in a box, NaN where it is not clear.

    Each pixel's window is correlated with windows in the same row of the right picture (zero mean, unit variance, so
    that the eyes' gains do not matter); a parabola through the best three places gives the fraction. A match must be
    mutual: matching from the right picture must give the same place.

    Args:
        left: (h, w) one channel of the left picture.
        right: of the right one.
        box_px: (u, v, width, height) in the left picture.
        disparity_px: (least, most) that are tried.
        window_px: width of the windows; odd.
    """
    u, v, wide, high = box_px
    least, most = int(np.floor(disparity_px[0])), int(np.ceil(disparity_px[1]))
    if most - least < 2:  # the best of them would have no neighbours
        return np.full((high, wide), np.nan)
    pad = window_px // 2 + 1
    one = _cut(left, u - pad, v - pad, wide + 2 * pad, high + 2 * pad)
    other = _cut(right, u - pad - most, v - pad, wide + 2 * pad + most - least, high + 2 * pad)
    mean_one, var_one = _moments(one, window_px)
    mean_other, var_other = _moments(other, window_px)
    scores = np.empty((most - least + 1, high, wide), dtype=np.float32)
    inside = np.s_[pad : pad + high, pad : pad + wide]
    for k in range(most - least + 1):
        start = most - least - k  # of the columns that match the left ones at disparity ``least + k``
        shifted = np.s_[:, start : start + one.shape[1]]
        both = cv2.blur(one * other[shifted], (window_px, window_px)) - mean_one * mean_other[shifted]
        scores[k] = (both / np.sqrt(var_one * var_other[shifted]))[inside]
    best = scores.argmax(0)
    top = np.take_along_axis(scores, best[None], 0)[0]
    inner = np.clip(best, 1, len(scores) - 2)
    before, here, after = (np.take_along_axis(scores, inner[None] + step, 0)[0] for step in (-1, 0, 1))
    curve = before - 2 * here + after  # negative where the best is in the middle
    part = 0.5 * (before - after) / np.minimum(curve, -1e-6)
    mutual = np.abs(best - _from_right(scores, best)) <= AGREE_PX
    good = (top >= LEAST_CORRELATION) & (best == inner) & mutual
    return np.where(good, least + inner + part, np.nan)


def _from_right(scores: NDArray[np.float32], best: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return, for each left pixel, the best disparity of the right pixel that it matches."""
    count, high, wide = scores.shape
    turned = np.full((count, high, wide + count - 1), -np.inf, dtype=np.float32)
    for k in range(count):
        turned[k, :, count - 1 - k : count - 1 - k + wide] = scores[k]
    chosen = turned.argmax(0)
    column = np.arange(wide)[None] - best + count - 1
    return np.take_along_axis(chosen, column, 1)


def _cut(picture: NDArray, u: int, v: int, wide: int, high: int) -> NDArray[np.float32]:
    """Return a rectangle as float; beyond the picture's border the last pixels are repeated."""
    rows = np.clip(np.arange(v, v + high), 0, picture.shape[0] - 1)
    columns = np.clip(np.arange(u, u + wide), 0, picture.shape[1] - 1)
    return picture[np.ix_(rows, columns)].astype(np.float32)


def _moments(patch: NDArray[np.float32], window_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean and variance of the window round each pixel."""
    mean = np.asarray(cv2.blur(patch, (window_px, window_px)), dtype=np.float32)
    square = np.asarray(cv2.blur(patch * patch, (window_px, window_px)), dtype=np.float32)
    return mean, np.maximum(square - mean * mean, FLAT)
