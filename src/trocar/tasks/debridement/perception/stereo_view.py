"""The perception of the debridement agents: fragments, grippers, and what jaws hold, in a pair of images."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.color import RED_FOAM, to_hsv
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoImage, StereoRig, StereoWindow, Window
from trocar.perception.stereo import disparity_map
from trocar.tasks.debridement.perception.fragments import SeenFragment, find_fragments
from trocar.tasks.debridement.perception.gripper import SeenGripper, find_gripper

MARGIN_M = 0.02
JAWS_M = 0.012  # half the size of the box round the controlled point that contains both fingers
LEAST_PX = 32  # least width and height of a window
BEYOND_AXIS_M = (4e-3, 28e-3)
"""Range, beyond the jaw axis, of the middle of a held fragment; the fingers end at 20 mm."""
ASIDE_M = 9e-3
"""Half-width of the box of a held fragment along the jaw axis and across; across, half the jaws' gap is added."""
MIN_AREA_M2 = 6e-6  # least red area between the fingers, as seen by the left eye; a fragment has 60 mm^2
BEHIND_M = 0.04
"""The background of the jaws is up to this much further away: on the work surface, or in the receptacle."""
CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
"""Corners (8, 3) of a box: 1 for its upper limit, 0 for its lower one."""


class StereoView:
    """Finds fragments and grippers in a pair of pictures. A perception of your own needs the same methods.

    ``T_world_camera`` is the pose of the left eye. Pictures are whole ones or windows.
    """

    def fragments(
        self, image: StereoImage, T_world_camera: SE3, T_world_table: SE3, arms: Mapping[str, ArmModel] | None = None
    ) -> list[SeenFragment]:
        """Return the fragments that both eyes see: on the table, in the receptacle, or between jaws."""
        return find_fragments(image, T_world_camera, T_world_table)

    def gripper(self, image: StereoImage, T_world_camera: SE3, arm: ArmModel) -> SeenGripper | None:
        """Return an arm's gripper from its marks, or None if they do not determine it."""
        return find_gripper(image, T_world_camera, arm)

    def gripper_window(
        self, T_world_tip_guess: SE3, T_world_camera: SE3, rig: StereoRig, margin_m: float = MARGIN_M, binning: int = 1
    ) -> StereoWindow | None:
        """Return the same rows of both eyes, round a gripper within ``margin_m`` of a pose; None if out of sight."""
        corners = (2 * CORNERS - 1) * (JAWS_M + margin_m)
        in_left = T_world_camera.inverse().apply(T_world_tip_guess.translation_m + corners)
        left, right = _box(rig.left, in_left), _box(rig.right, rig.T_left_right.inverse().apply(in_left))
        if left is None or right is None:
            return None
        top, bottom = max(left[1], right[1]), min(left[3], right[3])
        if bottom - top < LEAST_PX:
            return None
        left, right = ((box[0], top, box[2], bottom) for box in (left, right))
        return StereoWindow(_window(left, binning), _window(right, binning), binning)

    def holding(self, image: StereoImage, T_world_camera: SE3, arm: ArmModel, T_world_tip: SE3, jaw_rad: float) -> bool:
        """Return whether something red is between the fingers, by its disparity, and not merely in line with them.

        The tip may be off by some millimetres. A fragment held by jaws with this opening, or hanging from a finger's
        end, is no farther to the side than the fingers.
        """
        T_camera_tip, rig = T_world_camera.inverse() @ T_world_tip, image.rig
        aside_m = ASIDE_M + arm.instrument.finger_length_m * float(np.sin(0.5 * max(jaw_rad, 0.0)))
        lower = np.array([-aside_m, -ASIDE_M, arm.tip_length_m - BEYOND_AXIS_M[1]])
        upper = np.array([aside_m, ASIDE_M, arm.tip_length_m - BEYOND_AXIS_M[0]])
        corners = T_camera_tip.apply(np.where(CORNERS, upper, lower))
        if (corners[:, 2] <= 0).any():
            return False
        p_tip = T_camera_tip.inverse().apply(_red_points(image, corners))
        within = int(((p_tip >= lower) & (p_tip <= upper)).all(axis=-1).sum())
        return within * (float(corners[:, 2].mean()) / rig.left.fx) ** 2 >= MIN_AREA_M2


def _window(box: tuple[int, int, int, int], binning: int) -> Window:
    """Return the largest window in a box whose corner and size are multiples of the binning."""
    u, v, right, bottom = -(-box[0] // binning), -(-box[1] // binning), box[2] // binning, box[3] // binning
    return Window((binning * u, binning * v), (binning * (right - u), binning * (bottom - v)))


def _box(lens: Intrinsics, points_m: NDArray[np.float64]) -> tuple[int, int, int, int] | None:
    """Return the part of the picture that points span: first column, first row, end of columns, end of rows."""
    if (points_m[:, 2] <= 0).any():
        return None
    pixels = project(lens, points_m)
    first = np.maximum(np.floor(pixels.min(0)), 0).astype(int)
    end = np.minimum(np.ceil(pixels.max(0)) + 1, [lens.width, lens.height]).astype(int)
    if (end - first < LEAST_PX).any():
        return None
    return int(first[0]), int(first[1]), int(end[0]), int(end[1])


def _red_points(image: StereoImage, corners_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions (n, 3) of the red pixels in the left picture of a box, in the left eye's frame.

    Pixels are matched over the disparities of the box and of what may be behind it, so that background matches itself.
    """
    left, right, shift_m = image.rig.left, image.rig.right, float(image.rig.T_left_right.translation_m[0])
    outline = cv2.convexHull(np.rint(project(left, corners_m)).astype(np.int32))
    inside = np.zeros(image.left.shape[:2], dtype=np.uint8)
    cv2.fillConvexPoly(inside, outline, 1)
    red = (inside > 0) & (RED_FOAM.mask(to_hsv(image.left)) > 0)
    rows, columns = np.nonzero(red)
    if not len(rows):
        return np.zeros((0, 3))
    u, v = int(columns.min()), int(rows.min())
    box = u, v, int(columns.max()) - u + 1, int(rows.max()) - v + 1
    beside = left.cx - right.cx
    depths = float(corners_m[:, 2].min()), float(corners_m[:, 2].max()) + BEHIND_M
    near, far = (left.fx * shift_m / depth + beside for depth in depths)
    found = disparity_map(image.left[..., 0], image.right[..., 0], box, (far, near))[rows - v, columns - u]
    seen = np.isfinite(found) & (found > beside)
    depth = left.fx * shift_m / (found[seen] - beside)
    x, y = (columns[seen] - left.cx) / left.fx * depth, (rows[seen] - left.cy) / left.fy * depth
    return np.stack([x, y, depth], axis=-1)
