"""Stereo vision: triangulation, rectification, and disparities of textured surfaces."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.perception.depth import rays_through
from trocar.perception.image import Intrinsics, StereoImage, StereoRig

SAME_ROW = 1e-9  # relative difference of focal lengths, rotations and rows below which a pair counts as rectified
LEAST_CORRELATION = 0.6  # a window with less correlation counts as not found
AGREE_PX = 1.0  # maximum difference between the disparities found from the right and from the left picture
FLAT = 1.0  # least variance of a window, in squared grey levels: windows of noise alone would match anything


def triangulate(rig: StereoRig, left_px: ArrayLike, right_px: ArrayLike) -> tuple[Array, NDArray]:
    """Return points (..., 3) in the left camera's frame, and the distances (...,) in m between the rays.

    A point is the middle of the shortest line between the rays through its pixels (..., 2) u, v in both images. The
    pair need not be rectified. If the rays are parallel or meet behind an eye, point and distance are NaN.
    """
    one = rays_through(rig.left, left_px)
    other = rig.T_left_right.rotation.apply(rays_through(rig.right, right_px))
    shift = rig.T_left_right.translation_m
    aa, bb, ab = (np.sum(x * y, -1) for x, y in ((one, one), (other, other), (one, other)))
    a0, b0 = one @ shift, other @ shift
    determinant = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (bb * a0 - ab * b0) / determinant
        across = (ab * a0 - aa * b0) / determinant
    seen = (determinant > 1e-12 * aa * bb) & (along > 0) & (across > 0)
    near = np.where(seen, along, np.nan)[..., None] * one
    far = shift + np.where(seen, across, np.nan)[..., None] * other
    return 0.5 * (near + far), np.linalg.norm(near - far, axis=-1)


def is_rectified(rig: StereoRig) -> bool:
    """Return whether every point lies in the same row of both images, and further left in the right one."""
    left, right, shift = rig.left, rig.right, rig.T_left_right.translation_m
    return (
        not any(left.distortion)
        and not any(right.distortion)
        and bool(np.allclose(rig.T_left_right.rotation.matrix, np.eye(3), atol=SAME_ROW))
        and bool(np.abs(shift[1:]).max() < SAME_ROW)
        and shift[0] > 0
        and (left.fx, left.fy, left.cy, left.height) == (right.fx, right.fy, right.cy, right.height)
    )


def rectify(image: StereoImage) -> tuple[StereoImage, SO3]:
    """Return the rectified pair, without distortion, and ``R_left_rectified``.

    A pair that is already rectified is returned as it is. The new left camera stands where the old one does; a point p
    in its frame is ``R_left_rectified @ p`` in the old frame.

    Raises InvalidInput: the eyes stand on the same spot or behind each other.
    """
    rig = image.rig
    if is_rectified(rig):
        return image, SO3.identity()
    shift = rig.T_left_right.translation_m
    length = float(np.linalg.norm(shift))
    ahead = np.array([0.0, 0.0, 1.0]) + rig.T_left_right.rotation.matrix[:, 2]
    x = shift / max(length, 1e-12)
    z = ahead - (ahead @ x) * x
    if length < 1e-6 or np.linalg.norm(z) < 0.1:
        raise InvalidInput("a pair", "whose eyes do not stand side by side cannot be rectified", "check T_left_right")
    z /= np.linalg.norm(z)
    R_left_new = SO3.unchecked(np.column_stack([x, np.cross(z, x), z]))
    focal = min(rig.left.fx, rig.left.fy, rig.right.fx, rig.right.fy)
    eyes = [
        (image.left, rig.left, R_left_new),
        (image.right, rig.right, rig.T_left_right.rotation.inverse() @ R_left_new),
    ]
    lenses = [_new_lens(lens, R, focal) for _, lens, R in eyes]
    cy, height = 0.5 * (lenses[0].cy + lenses[1].cy), max(lens.height for lens in lenses)
    lenses = [replace(lens, cy=cy, height=height) for lens in lenses]
    pictures = [_warped(*eye, lens) for eye, lens in zip(eyes, lenses, strict=True)]
    new_rig = StereoRig(lenses[0], lenses[1], SE3.from_parts(translation_m=[length, 0.0, 0.0]))
    return StereoImage(pictures[0], pictures[1], new_rig, image.time_s), R_left_new


def _new_lens(lens: Intrinsics, R_lens_new: SO3, focal: float) -> Intrinsics:
    """Return a lens without distortion, rotated, whose picture has the old picture's centre in its middle."""
    middle = rays_through(lens, [(lens.width - 1) / 2, (lens.height - 1) / 2]) @ R_lens_new.matrix
    cx = (lens.width - 1) / 2 - focal * middle[0] / middle[2]
    cy = (lens.height - 1) / 2 - focal * middle[1] / middle[2]
    return Intrinsics(lens.width, lens.height, focal, focal, float(cx), float(cy))


def _warped(picture: NDArray[np.uint8], lens: Intrinsics, R_lens_new: SO3, new: Intrinsics) -> NDArray[np.uint8]:
    size = (new.width, new.height)
    maps = cv2.initUndistortRectifyMap(
        lens.matrix, np.array(lens.distortion), R_lens_new.matrix.T, new.matrix, size, cv2.CV_32FC1
    )
    return np.asarray(cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR), dtype=np.uint8)


def disparity_map(
    left: NDArray,
    right: NDArray,
    box_px: tuple[int, int, int, int],
    disparity_px: tuple[float, float],
    window_px: int = 9,
) -> Array:
    """Return the disparity (h, w) of the left pixels in a box, NaN where it is ambiguous.

    Each pixel's window is correlated with windows in the same row of the right picture (zero mean, unit variance, so
    that the eyes' gains do not matter). A parabola through the best correlation and its neighbours gives the fraction
    of a pixel. A match must be mutual: matching from the right picture must give the same place.

    Args:
        left: (rows, columns) one channel of the left picture.
        right: the same channel of the right picture.
        box_px: (u, v, w, h) of the box in the left picture.
        disparity_px: least and greatest disparity to try.
        window_px: width of the windows; odd.
    """
    u, v, wide, high = box_px
    least, most = int(np.floor(disparity_px[0])), int(np.ceil(disparity_px[1]))
    if most - least < 2:  # no disparity would have neighbours on both sides
        return np.full((high, wide), np.nan)
    pad = window_px // 2 + 1
    one = _cut(left, u - pad, v - pad, wide + 2 * pad, high + 2 * pad)
    other = _cut(right, u - pad - most, v - pad, wide + 2 * pad + most - least, high + 2 * pad)
    mean_one, var_one = _moments(one, window_px)
    mean_other, var_other = _moments(other, window_px)
    scores = np.empty((most - least + 1, high, wide), dtype=np.float32)
    inside = np.s_[pad : pad + high, pad : pad + wide]
    for k in range(most - least + 1):
        start = most - least - k  # first column of the right cut-out at disparity ``least + k``
        shifted = np.s_[:, start : start + one.shape[1]]
        both = cv2.blur(one * other[shifted], (window_px, window_px)) - mean_one * mean_other[shifted]
        scores[k] = (both / np.sqrt(var_one * var_other[shifted]))[inside]
    best = scores.argmax(0)
    top = np.take_along_axis(scores, best[None], 0)[0]
    inner = np.clip(best, 1, len(scores) - 2)
    before, here, after = (np.take_along_axis(scores, inner[None] + step, 0)[0] for step in (-1, 0, 1))
    curve = before - 2 * here + after  # negative at a maximum
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
