"""The lenses of a stereo pair, and the relative pose of its eyes, from views of a checkerboard."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard.board import MIN_VIEWS, Checkerboard
from trocar.perception.image import Intrinsics, StereoRig

STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
LENS = cv2.CALIB_FIX_K3
"""k1 k2 p1 p2 are free; k3 of a 6 mm lens cannot be observed over so small a workspace."""


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """A calibrated pair.

    Attributes:
        rig: its lenses, and the pose of the right eye in the left.
        rms_px: distance between corners and their projections over all views and both eyes.
        views: how many it was calibrated from.
    """

    rig: StereoRig
    rms_px: float
    views: int


def calibrate_stereo(
    board: Checkerboard, left_px: NDArray[np.float64], right_px: NDArray[np.float64], size_px: tuple[int, int]
) -> StereoCalibration:
    """Return the pair that projects the board's corners nearest to where both eyes see them, over all views.

    Args:
        board: that was shown.
        left_px: (n, k, 2) corners in the left eye's images, in the board's order.
        right_px: (n, k, 2) likewise, of the same moments.
        size_px: width and height of the images.

    Raises:
        TrocarError: there are too few views.
    """
    corners = board.corners_m.astype(np.float32)
    shape = (len(left_px), len(corners), 2)
    if left_px.shape != shape or right_px.shape != shape:
        raise TrocarError(f"corners of both eyes need shape {shape}, got {left_px.shape} and {right_px.shape}")
    if len(left_px) < MIN_VIEWS:
        raise TrocarError(
            f"{len(left_px)} views in which both eyes see the whole board are too few for a calibration; show the "
            f"board in {MIN_VIEWS} or more poses, tilted, all over the image"
        )
    objects = [corners] * len(left_px)
    left, right = ([view.astype(np.float32)[:, None] for view in views] for views in (left_px, right_px))
    (left_matrix, left_bend), (right_matrix, right_bend) = (_lens(objects, views, size_px) for views in (left, right))
    rms, left_matrix, left_bend, right_matrix, right_bend, turn, shift, *_ = cv2.stereoCalibrate(
        objects,
        left,
        right,
        left_matrix,
        left_bend,
        right_matrix,
        right_bend,
        size_px,
        flags=LENS | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=STOP,
    )
    T_right_left = SE3.from_parts(SO3(np.asarray(turn, dtype=np.float64)), np.ravel(shift))
    rig = StereoRig(
        _intrinsics(left_matrix, left_bend, size_px),
        _intrinsics(right_matrix, right_bend, size_px),
        T_right_left.inverse(),
    )
    return StereoCalibration(rig, float(rms), len(left_px))


def _lens(objects: list, views: list, size_px: tuple[int, int]) -> tuple[NDArray, NDArray]:
    """Return camera matrix and distortion of one eye alone."""
    _, matrix, bend, *_ = cv2.calibrateCamera(
        objects, views, size_px, np.eye(3), np.zeros(5), flags=LENS, criteria=STOP
    )
    return matrix, bend


def _intrinsics(matrix: NDArray, bend: NDArray, size_px: tuple[int, int]) -> Intrinsics:
    numbers = (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]))
    return Intrinsics(*size_px, *numbers, tuple(np.ravel(bend)[:5].tolist()))  # type: ignore[arg-type]
