"""A checkerboard painted through a lens, each pixel by its own ray: images without the simulator."""

from functools import lru_cache

import cv2
import numpy as np

from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoRig

BOARD = Checkerboard(columns=10, rows=7, square_m=8e-3)
RIG = StereoRig(
    Intrinsics(640, 480, 810.0, 806.0, 322.0, 236.0, (-0.12, 0.08, 0.001, -0.0008, 0.0)),
    Intrinsics(640, 480, 802.0, 805.0, 317.0, 243.0, (-0.10, 0.05, -0.001, 0.0005, 0.0)),
    SE3.from_parts(SO3.exp([0.01, -0.03, 0.005]), [0.047, 0.001, -0.002]),
)
WHITE, BLACK, BACKGROUND = 200.0, 20.0, 90.0
FINE = 2
"""Rays along each side of a pixel."""


def picture(lens: Intrinsics, T_lens_board: SE3, board: Checkerboard = BOARD, light: float = 1.0, noise: float = 2.0):
    """Return a picture (h, w, 3) of a board; ``light`` is the exposure, ``noise`` the SD of grey levels."""
    fine = Intrinsics(
        lens.width * FINE,
        lens.height * FINE,
        lens.fx * FINE,
        lens.fy * FINE,
        lens.cx * FINE + (FINE - 1) / 2,
        lens.cy * FINE + (FINE - 1) / 2,
        lens.distortion,
    )
    around = _around(lens, T_lens_board, board)
    rays = _rays(fine)[tuple(slice(FINE * part.start, FINE * part.stop) for part in around)]
    normal, origin = T_lens_board.rotation.matrix[:, 2], T_lens_board.translation_m
    points = rays * ((normal @ origin) / (rays @ normal))[..., None]
    x, y, _ = np.moveaxis(T_lens_board.inverse().apply(points), -1, 0)
    width, height = board.size_m
    column = np.floor((x + width / 2) / board.square_m)
    row = np.floor((y + height / 2) / board.square_m)
    inside = (column >= 0) & (column <= board.columns) & (row >= 0) & (row <= board.rows)
    rim = (np.abs(x) < width / 2 + board.square_m) & (np.abs(y) < height / 2 + board.square_m)
    level = np.where(inside & ((column + row) % 2 == 0), BLACK, np.where(rim, WHITE, BACKGROUND))
    gray = np.full((lens.height, lens.width), BACKGROUND * light)
    gray[around] = cv2.resize(level, gray[around].shape[::-1], interpolation=cv2.INTER_AREA) * light
    gray = gray + noise * np.random.default_rng(1).standard_normal(gray.shape)
    return np.repeat(np.clip(np.rint(gray), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def _around(lens: Intrinsics, T_lens_board: SE3, board: Checkerboard):
    """Return the rows and columns that contain the board and its rim; the rest is background."""
    half = 0.55 * np.array(board.size_m) + board.square_m
    rim = np.stack(np.meshgrid(*np.linspace(-half, half, 9).T, [0.0]), -1).reshape(-1, 3)
    (u0, v0), (u1, v1) = (f(project(lens, T_lens_board.apply(rim)), axis=0).astype(int) for f in (np.min, np.max))
    return np.s_[max(v0, 0) : min(v1 + 2, lens.height), max(u0, 0) : min(u1 + 2, lens.width)]


@lru_cache(maxsize=4)
def _rays(lens: Intrinsics):
    """Return the direction (h, w, 3) of each pixel, by OpenCV rather than by the code under test."""
    pixels = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1).astype(np.float64)
    flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), lens.matrix, np.array(lens.distortion))
    return np.concatenate([flat[:, 0], np.ones((len(flat), 1))], -1).reshape(lens.height, lens.width, 3)


def corners(T_left_board: SE3, board: Checkerboard = BOARD):
    """Return the pixels of the board's corners in the left and the right eye of ``RIG``."""
    p_left = T_left_board.apply(board.corners_m)
    p_right = RIG.T_left_right.inverse().apply(p_left)
    return project(RIG.left, p_left), project(RIG.right, p_right)


def poses(count: int, seed: int = 0) -> list[SE3]:
    """Return random poses of the board, in the left eye's frame, at which both eyes see all of it."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        place = (0.0235 + rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), rng.uniform(0.2, 0.3))
        T = SE3.from_parts(SO3.exp(rng.uniform(-0.6, 0.6, 3)), place)
        if all(((px > 20) & (px < (620, 460))).all() for px in corners(T)):
            found.append(T)
    return found
