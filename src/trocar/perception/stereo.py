"""Two eyes: rectified pairs, and points from pixels that both eyes see."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import rays_through
from trocar.perception.image import Intrinsics, StereoImage, StereoRig

SAME_ROW = 1e-9
"""Relative difference of focal lengths, rotations and rows below which a pair counts as rectified."""


def triangulate(rig: StereoRig, left_px: ArrayLike, right_px: ArrayLike) -> tuple[NDArray[np.float64], NDArray]:
    """Return points (..., 3) in the left camera's frame, and by how much the two rays miss each other (...,) in m.

    A point is the middle of the shortest line between the rays through its pixels. Works for every pair of lenses; if
    the rays are parallel or meet behind an eye, point and miss are NaN.

    Args:
        rig: the cameras.
        left_px: (..., 2) u, v in the left image.
        right_px: (..., 2) of the same points in the right one.
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
    """Return whether a point lies in the same row of both images, further left in the right one."""
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
    """Return the pair as cameras without distortion, side by side, would have seen it; and ``R_left_rectified``.

    A pair that is rectified already is returned as it is. The new left camera stands where the old one does; a point p
    in its frame is ``R_left_rectified`` p in the old one's.

    Raises:
        TrocarError: the pictures do not match the rig, or the eyes stand on the same spot or behind each other.
    """
    rig = image.rig
    check_stereo(image)
    if is_rectified(rig):
        return image, SO3.identity()
    shift = rig.T_left_right.translation_m
    length = float(np.linalg.norm(shift))
    ahead = np.array([0.0, 0.0, 1.0]) + rig.T_left_right.rotation.matrix[:, 2]
    x = shift / max(length, 1e-12)
    z = ahead - (ahead @ x) * x
    if length < 1e-6 or np.linalg.norm(z) < 0.1:
        raise TrocarError("the eyes of the pair do not stand side by side: it cannot be rectified; check T_left_right")
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


def check_stereo(image: StereoImage) -> None:
    """Raise TrocarError if the pictures do not match their cameras."""
    for name, picture, lens in (("left", image.left, image.rig.left), ("right", image.right, image.rig.right)):
        if picture.shape != (lens.height, lens.width, 3) or picture.dtype != np.uint8:
            raise TrocarError(
                f"the {name} eye of {lens.width} x {lens.height} pixels needs a picture "
                f"{(lens.height, lens.width, 3)} of uint8, got {picture.shape} of {picture.dtype}"
            )


def _new_lens(lens: Intrinsics, R_lens_new: SO3, focal: float) -> Intrinsics:
    """Return a lens without distortion whose picture has the same centre."""
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
