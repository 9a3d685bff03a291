"""Pose of the pegboard from one colour and depth image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.perception.color import red_mask
from trocar.perception.depth import patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.shapes import Pegboard

REACH_M = (0.075, 0.060)
"""Half-size of the search region in x and y: the peg positions, with a guess that is off by up to 15 mm."""
MARGIN_M = 4e-3
PLANE_GATES_M = (6e-3, 4e-3, 2e-3, 1.0e-3, 0.6e-3)
AXIS_GATES_M = (8e-3, 6e-3, 4e-3)
PEG_GATES_M = (1.5e-3, 1.0e-3)
PEG_BAND_M = (0.80, 0.94)
"""Part of the pegs' height that is used: above the blocks' tops (.745) and below the rounded end."""
MIN_PEG_PIXELS = 6
MIN_PEGS = 6
MIN_PLANE_PIXELS = 300
MAX_RMS_M = 0.5e-3


def find_board(
    image: RgbdImage, T_world_camera: SE3, board: Pegboard, T_world_board_guess: SE3 | None = None
) -> SE3 | str:
    """Return ``T_world_board``, or why no board was found: height and tilt from the plate, x, y and yaw from the pegs.

    Pegs protrude above the blocks, so both bare and occupied pegs are used; each pixel on a peg's end lies one radius
    from its axis. The guess may be off by about 8 mm and 5 deg.

    Args:
        image: colour and depth.
        T_world_camera: the camera's calibrated pose.
        board: the board's shape.
        T_world_board_guess: approximate pose of the board; default: the world's frame.
    """
    T_world_board = SE3.identity() if T_world_board_guess is None else T_world_board_guess
    T_board_camera = T_world_board.inverse() @ T_world_camera
    box = np.array([*REACH_M, 0.0])
    patch = patch_around(image, T_board_camera.inverse(), -box, box + [0, 0, board.peg_height_m])
    if patch is None:
        return "the board lies outside the image"
    red = red_mask(patch.color) & np.isfinite(patch.depth_m)
    points = T_board_camera.apply(patch.points_m[red])
    T_guess_level = _level(points, board)
    if T_guess_level is None:
        return "no plate was seen where the board should be"
    points = T_guess_level.inverse().apply(points)
    eye = (T_guess_level.inverse() @ T_board_camera).translation_m
    x, y, yaw, rms, seen = _fit_pegs(points, board, eye[:2])
    if seen < MIN_PEGS or not rms < MAX_RMS_M:
        return f"only {seen} of {len(board.pegs_m)} pegs were seen, {rms * 1e3:.2f} mm rms off their cylinders"
    return T_world_board @ T_guess_level @ SE3.from_parts(SO3.axis("z", yaw), [x, y, 0.0])


def _level(points: NDArray[np.float64], board: Pegboard) -> SE3 | None:
    """Return the pose, in the guessed frame, of a frame with the plate's surface at z = 0."""
    width, depth, _ = board.plates_m[0]
    on_plate = (np.abs(points[:, 0]) < width / 2 - MARGIN_M) & (np.abs(points[:, 1]) < depth / 2 - MARGIN_M)
    low = points[on_plate]
    a = b = c = 0.0
    for gate in PLANE_GATES_M:
        residual = low[:, 2] - (a * low[:, 0] + b * low[:, 1] + c)
        near = low[np.abs(residual) < gate]
        if len(near) < MIN_PLANE_PIXELS:
            return None
        A = np.column_stack([near[:, :2], np.ones(len(near))])
        a, b, c = np.linalg.lstsq(A, near[:, 2], rcond=None)[0]
    axis = np.cross([0, 0, 1.0], [-a, -b, 1.0])
    tilt = np.arctan(np.hypot(a, b))
    size = np.linalg.norm(axis)
    rotation = SO3.exp(axis / size * tilt) if size > 1e-12 else SO3.identity()
    return SE3.from_parts(rotation, [0.0, 0.0, c])


def _fit_pegs(
    points: NDArray[np.float64], board: Pegboard, eye_m: NDArray[np.float64]
) -> tuple[float, float, float, float, int]:
    """Return x, y, yaw of the board in the level frame, the pegs' rms, and how many pegs were used.

    Gauss-Newton on (distance to the peg's axis - radius) with Huber weights, each pixel assigned to its nearest peg.
    The camera sees only the front half of a cylinder, which would also fit the back half from inside. Therefore the
    first stages move the pixels away from the camera by the mean depth of a half circle (pi/4 r), to where the axis is,
    and minimise their distance to the axes.
    """
    low, high = (share * board.peg_height_m for share in PEG_BAND_M)
    ends = points[(points[:, 2] > low) & (points[:, 2] < high)][:, :2]
    view = ends - eye_m
    behind = ends + np.pi / 4 * board.peg_radius_m * view / np.linalg.norm(view, axis=-1, keepdims=True)
    stages = [(gate, behind, 0.0) for gate in AXIS_GATES_M for _ in range(4)]
    stages += [(gate, ends, board.peg_radius_m) for gate in PEG_GATES_M for _ in range(4)]
    pegs = board.pegs_m[:, :2]
    x = y = yaw = 0.0
    rms = np.inf
    seen = np.zeros(len(pegs), dtype=bool)
    for gate, visible, radius in stages:
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        local = (visible - [x, y]) @ turn
        offset = local[:, None] - pegs
        distance = np.linalg.norm(offset, axis=-1)
        nearest = np.argmin(distance, -1)
        rows = np.arange(len(ends))
        residual = distance[rows, nearest] - radius
        keep = np.abs(residual) < gate
        counts = np.bincount(nearest[keep], minlength=len(pegs))
        seen = counts >= MIN_PEG_PIXELS
        keep &= seen[nearest]
        if keep.sum() < 3 * MIN_PEG_PIXELS:
            return 0.0, 0.0, 0.0, float("inf"), 0
        normal = offset[rows, nearest][keep] / np.maximum(distance[rows, nearest][keep], 1e-9)[:, None]
        r, at = residual[keep], local[keep]
        jacobian = np.column_stack([-normal @ turn.T, normal[:, 0] * at[:, 1] - normal[:, 1] * at[:, 0]])
        weight = np.minimum(1.0, 0.3e-3 / np.maximum(np.abs(r), 1e-9)) / np.maximum(counts[nearest[keep]], 1)
        step = np.linalg.lstsq(jacobian * np.sqrt(weight)[:, None], -r * np.sqrt(weight), rcond=None)[0]
        x, y, yaw = x + step[0], y + step[1], yaw + step[2]
        rms = float(np.sqrt(np.mean(r**2)))
    return float(x), float(y), float(yaw), rms, int(seen.sum())
