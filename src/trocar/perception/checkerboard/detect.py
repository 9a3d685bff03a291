"""The corners of a checkerboard in an image, in the board's order."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.perception.checkerboard.board import Checkerboard

DARKEST, BRIGHTEST = 1.0, 99.0
"""Percentiles of the image that become black and white before corners are searched for, so exposure does not matter."""
ATTEMPTS = (
    (0.0, cv2.CALIB_CB_EXHAUSTIVE),
    (1.0, cv2.CALIB_CB_EXHAUSTIVE),
    (1.0, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE),
)
"""SD of a blur in pixels and flags of OpenCV's search, one after the other until one finds the board."""
REFINE_BLUR_PX, REFINE_SHARE, REFINE_PX = 1.0, 0.4, 1.5
"""Then each corner is moved to where nearby gradients intersect: SD of a blur, half the window as a share of the
distance between corners, and the greatest shift allowed. OpenCV's search alone shifts whole boards by some .05 px."""
STEPS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
MIN_CONTRAST = 3.0
"""Least difference in grey levels between white and black squares as exposed; with less, it is not a board."""


def find_corners(board: Checkerboard, image: NDArray[np.uint8]) -> NDArray[np.float64] | None:
    """Return the inner corners (rows * columns, 2) u, v of a board in the board's order, or None if it is not seen.

    Args:
        board: the one to search for; the whole of it must be in the image.
        image: (height, width, 3) uint8 RGB.

    Raises:
        TrocarError: the image is of another shape.
    """
    if image.ndim != 3 or image.shape[-1] != 3 or image.dtype != np.uint8:
        raise TrocarError(f"a checkerboard is looked for in (height, width, 3) uint8, got {image.dtype} {image.shape}")
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    low, high = np.percentile(gray, (DARKEST, BRIGHTEST))
    stretched = np.clip((gray - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    for blur_px, flags in ATTEMPTS:
        seen = cv2.GaussianBlur(stretched, (0, 0), blur_px) if blur_px else stretched
        found, corners = cv2.findChessboardCornersSB(seen, (board.columns, board.rows), flags=flags)
        if found:
            grid = np.asarray(corners, dtype=np.float64).reshape(board.rows, board.columns, 2)
            return _in_order(board, _refined(grid, stretched), gray)
    return None


def _refined(grid: NDArray[np.float64], picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return corners (rows, columns, 2) at the saddles of brightness; one that would move far stays where it is."""
    apart = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    half = max(2, int(REFINE_SHARE * apart))
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), REFINE_BLUR_PX)
    start = grid.astype(np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(smooth, start.copy(), (half, half), (-1, -1), STEPS)
    moved = np.asarray(moved, dtype=np.float64).reshape(grid.shape)
    near = np.linalg.norm(moved - grid, axis=-1, keepdims=True) < REFINE_PX
    return np.where(near, moved, grid)


def _in_order(board: Checkerboard, grid: NDArray[np.float64], gray: NDArray[np.uint8]) -> NDArray[np.float64] | None:
    """Return corners (rows, columns, 2), in whichever order they were found, as (n, 2) in the board's."""
    along_x, along_y = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    (ax, ay), (bx, by) = along_x.mean(0), along_y.mean(0)
    if ax * by - ay * bx < 0:
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
