"""The pixels to read out to see one gripper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoRig, StereoWindow, Window

MARGIN_M = 0.02
JAWS_M = 0.012
"""Half the size of the box round the controlled point that contains both fingers."""
LEAST_PX = 32


def gripper_window(
    T_world_tip: SE3, T_world_camera: SE3, rig: StereoRig, margin_m: float = MARGIN_M, binning: int = 1
) -> StereoWindow | None:
    """Return the same rows of both eyes, round a gripper within ``margin_m`` of a pose; None if out of sight."""
    reach = JAWS_M + margin_m
    corners = np.array([[(i >> k & 1) * 2 - 1 for k in range(3)] for i in range(8)]) * reach
    in_left = T_world_camera.inverse().apply(T_world_tip.translation_m + corners)
    boxes = [_box(rig.left, in_left), _box(rig.right, rig.T_left_right.inverse().apply(in_left))]
    if boxes[0] is None or boxes[1] is None:
        return None
    top, bottom = (max, min)[0](boxes[0][1], boxes[1][1]), min(boxes[0][3], boxes[1][3])
    if bottom - top < LEAST_PX:
        return None
    left, right = (_window((box[0], top, box[2], bottom), binning) for box in boxes if box is not None)
    return StereoWindow(left, right, binning)


def _window(box: tuple[int, int, int, int], binning: int) -> Window:
    """Return the largest window in a box whose corner and size are multiples of the binning."""
    left, top, right, bottom = (-(-box[0] // binning), -(-box[1] // binning), box[2] // binning, box[3] // binning)
    return Window((binning * left, binning * top), (binning * (right - left), binning * (bottom - top)))


def _box(lens: Intrinsics, points_m: NDArray[np.float64]) -> tuple[int, int, int, int] | None:
    """Return first column, first row, and the ends of both, of the part of the picture spanned by points."""
    if (points_m[:, 2] <= 0).any():
        return None
    pixels = project(lens, points_m)
    first = np.maximum(np.floor(pixels.min(0)), 0).astype(int)
    end = np.minimum(np.ceil(pixels.max(0)) + 1, [lens.width, lens.height]).astype(int)
    if (end - first < LEAST_PX).any():
        return None
    return int(first[0]), int(first[1]), int(end[0]), int(end[1])
