"""A checkerboard seen by a stereo pair: its corners, the lenses, the board's pose (Kehoe et al. 2014, IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.perception.checkerboard import MIN_VIEWS, Checkerboard
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoRig

DARKEST, BRIGHTEST = 1.0, 99.0
"""Percentiles that become black and white before the search for corners, so that exposure does not matter."""
REFINE_BLUR_PX, REFINE_SHARE, REFINE_PX = 1.0, 0.4, 1.5
"""Refinement of corners by OpenCV's ``cornerSubPix``: SD of a blur before it, half its window as a share of the
distance between corners, and the greatest shift allowed. Without it, whole boards are off by some .05 px."""
REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
MIN_CONTRAST = 3.0
"""Least difference in grey levels between the white and the black squares of a board."""

CALIBRATED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
LENS = cv2.CALIB_FIX_K3  # k1 k2 p1 p2 are free; k3 of a 6 mm lens cannot be observed over so small a workspace
LENGTH_M = 0.1  # a rotation by 1 rad counts as much as a shift by this length, to scale both alike for the solver


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """A calibrated pair."""

    rig: StereoRig  # its lenses, and the pose of the right eye in the left
    rms_px: float  # distance between corners and their projections over all views and both eyes
    views: int  # how many it was calibrated from


@dataclass(frozen=True, eq=False)
class BoardPose:
    """The pose of a board."""

    T_left_board: SE3  # pose of the board in the left eye's camera
    rms_px: float  # distance between corners and their projections over both eyes


def find_corners(board: Checkerboard, image: NDArray[np.uint8]) -> Array | None:
    """Return the inner corners (n, 2) u, v of a whole board in an RGB image, in the board's order; None if not seen."""
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    low, high = np.percentile(gray, (DARKEST, BRIGHTEST))
    stretched = np.clip((gray - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(stretched, size, flags=cv2.CALIB_CB_EXHAUSTIVE)
    if not found:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(board.rows, board.columns, 2)
    return _in_order(board, _refined(grid, stretched), gray)


def calibrate_stereo(
    board: Checkerboard, left_px: Array, right_px: Array, size_px: tuple[int, int]
) -> StereoCalibration:
    """Return the pair that projects the board's corners nearest to where both eyes see them, over all views.

    The corners (n, k, 2) of both eyes are in the board's order, and of the same views; ``size_px`` is width, height.

    Raises InvalidInput: there are too few views.
    """
    corners = board.corners_m.astype(np.float32)
    _require_corners(left_px, right_px, (len(left_px), len(corners), 2))
    if len(left_px) < MIN_VIEWS:
        problem = "are too few for a calibration"
        remedy = f"show the board in {MIN_VIEWS} or more poses, tilted, all over the image"
        raise InvalidInput(f"{len(left_px)} views in which both eyes see the whole board", problem, remedy)
    objects = [corners] * len(left_px)
    left, right = ([view.astype(np.float32)[:, None] for view in views] for views in (left_px, right_px))
    (K1, d1), (K2, d2) = (  # each eye alone, then both together
        cv2.calibrateCamera(objects, views, size_px, np.eye(3), np.zeros(5), flags=LENS, criteria=CALIBRATED)[1:3]
        for views in (left, right)
    )
    flags = LENS | cv2.CALIB_USE_INTRINSIC_GUESS
    rms, K1, d1, K2, d2, R_right_left, t_right_left, *_ = cv2.stereoCalibrate(
        objects, left, right, K1, d1, K2, d2, size_px, flags=flags, criteria=CALIBRATED
    )
    T_right_left = SE3.from_parts(SO3(np.asarray(R_right_left, dtype=np.float64)), np.ravel(t_right_left))
    rig = StereoRig(_intrinsics(K1, d1, size_px), _intrinsics(K2, d2, size_px), T_right_left.inverse())
    return StereoCalibration(rig, float(rms), len(left_px))


def board_pose(board: Checkerboard, rig: StereoRig, left_px: Array, right_px: Array) -> BoardPose:
    """Return the pose that projects the corners nearest to where both eyes see them.

    The corners (n, 2) of both eyes are in the board's order.

    Raises InvalidInput: no pose of the board explains the corners.
    """
    corners = board.corners_m
    _require_corners(left_px, right_px, (len(corners), 2))
    T_right_left = rig.T_left_right.inverse()

    def off_px(T_left_board: SE3) -> Array:
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
        problem = "fit no pose before both eyes"
        raise InvalidInput("the corners of the board", problem, "check that each is in its place")
    guess = min(guesses, key=lambda T: float(np.sum(off_px(T) ** 2)))
    scale = np.repeat([LENGTH_M, 1.0], 3)
    fit = least_squares(lambda step: off_px(guess @ SE3.exp(step * scale)).ravel(), np.zeros(6), method="lm")
    T = guess @ SE3.exp(fit.x * scale)
    return BoardPose(T, float(np.sqrt(np.mean(np.sum(off_px(T) ** 2, axis=-1)))))


def _refined(grid: Array, picture: NDArray[np.uint8]) -> Array:
    """Return corners (rows, columns, 2) refined to saddle points of brightness, except those that would move far."""
    apart = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    half = max(2, int(REFINE_SHARE * apart))
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), REFINE_BLUR_PX)
    start = grid.astype(np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(smooth, start.copy(), (half, half), (-1, -1), REFINED)
    moved = np.asarray(moved, dtype=np.float64).reshape(grid.shape)
    near = np.linalg.norm(moved - grid, axis=-1, keepdims=True) < REFINE_PX
    return np.where(near, moved, grid)


def _in_order(board: Checkerboard, grid: Array, gray: NDArray[np.uint8]) -> Array | None:
    """Return corners (rows, columns, 2) as (n, 2) in the board's order; None if the squares have no contrast."""
    (ax, ay), (bx, by) = (grid[:, -1] - grid[:, 0]).mean(0), (grid[-1] - grid[0]).mean(0)
    if ax * by - ay * bx < 0:  # seen in a mirror: columns run the other way
        grid = grid[:, ::-1]
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    at = np.rint(middles).astype(int)
    height, width = gray.shape
    levels = cv2.blur(gray, (3, 3))[at[..., 1].clip(0, height - 1), at[..., 0].clip(0, width - 1)].astype(float)
    black = board.inner_black
    contrast = float(levels[~black].mean() - levels[black].mean())
    if abs(contrast) < MIN_CONTRAST:
        return None
    return (grid if contrast > 0 else grid[::-1, ::-1]).reshape(-1, 2)


def _require_corners(left_px: Array, right_px: Array, shape: tuple[int, ...]) -> None:
    if left_px.shape != shape or right_px.shape != shape:
        problem = f"have shapes {left_px.shape} and {right_px.shape}"
        raise InvalidInput("corners of both eyes", problem, f"they need {shape}")


def _intrinsics(matrix: NDArray, distortion: NDArray, size_px: tuple[int, int]) -> Intrinsics:
    numbers = (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]))
    return Intrinsics(*size_px, *numbers, tuple(np.ravel(distortion)[:5].tolist()))  # type: ignore[arg-type]
