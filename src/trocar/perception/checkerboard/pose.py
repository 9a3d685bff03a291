"""The pose of a checkerboard seen by both eyes of a pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard.board import Checkerboard
from trocar.perception.depth import project
from trocar.perception.image import StereoRig

LENGTH_M = 0.1
"""A rotation by 1 rad counts as much as a shift by this length, to scale both alike for the solver."""


@dataclass(frozen=True, eq=False)
class BoardPose:
    """The pose of a board.

    Attributes:
        T_left_board: pose of the board in the left eye's camera.
        rms_px: distance between corners and their projections over both eyes.
    """

    T_left_board: SE3
    rms_px: float


def board_pose(
    board: Checkerboard, rig: StereoRig, left_px: NDArray[np.float64], right_px: NDArray[np.float64]
) -> BoardPose:
    """Return the pose that projects the corners nearest to where both eyes see them.

    Args:
        board: which one.
        rig: the calibrated pair.
        left_px: (n, 2) corners in the left eye's image, in the board's order.
        right_px: (n, 2) likewise.

    Raises:
        TrocarError: no pose of the board explains the corners.
    """
    corners = board.corners_m
    if left_px.shape != (len(corners), 2) or right_px.shape != (len(corners), 2):
        raise TrocarError(f"corners need shape {(len(corners), 2)}, got {left_px.shape} and {right_px.shape}")
    T_right_left = rig.T_left_right.inverse()

    def off_px(T_left_board: SE3) -> NDArray[np.float64]:
        p_left = T_left_board.apply(corners)
        return np.concatenate(
            [project(rig.left, p_left) - left_px, project(rig.right, T_right_left.apply(p_left)) - right_px]
        )

    # a flat board has two poses that one eye can hardly tell apart; the other eye can
    _, turns, shifts, *_ = cv2.solvePnPGeneric(
        corners, left_px, rig.left.matrix, np.array(rig.left.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    found = (np.concatenate([np.ravel(shift), np.ravel(turn)]) for turn, shift in zip(turns, shifts, strict=True))
    guesses = [SE3.from_parts(SO3.exp(f[3:]), f[:3]) for f in found if np.isfinite(f).all()]
    guesses = [guess for guess in guesses if np.isfinite(off_px(guess)).all()]
    if not guesses:
        raise TrocarError("no pose before both eyes explains the corners of the board; check that each is in its place")
    guess = min(guesses, key=lambda T: float(np.sum(off_px(T) ** 2)))
    scale = np.repeat([LENGTH_M, 1.0], 3)
    fit = least_squares(lambda step: off_px(guess @ SE3.exp(step * scale)).ravel(), np.zeros(6), method="lm")
    T = guess @ SE3.exp(fit.x * scale)
    return BoardPose(T, float(np.sqrt(np.mean(np.sum(off_px(T) ** 2, axis=-1)))))
