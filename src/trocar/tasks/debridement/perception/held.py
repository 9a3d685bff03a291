"""Whether a gripper holds a fragment: pixels only (Kehoe 2014, III-B)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.color import RED_FOAM, to_hsv
from trocar.perception.depth import project
from trocar.perception.image import StereoImage
from trocar.perception.stereo import disparity_map

BEYOND_AXIS_M = (4e-3, 28e-3)
"""Range, beyond the jaw axis, of the middle of a held fragment; the fingers end at 20 mm."""
ASIDE_M = 9e-3
"""Half-width of that box along the jaw axis and across; across, the distance of the fingers' ends is added."""
MIN_AREA_M2 = 6e-6
"""Least red area between the fingers, as seen by the left eye; a fragment has 60 mm^2."""


BEHIND_M = 0.04
"""The background of the jaws is up to this much further away: on the work surface, or in the receptacle."""


def is_holding(image: StereoImage, T_world_camera: SE3, arm: ArmModel, T_world_tip: SE3, jaw_rad: float) -> bool:
    """Return whether something red is between the fingers, by its disparity, and not merely in line with them.

    Args:
        image: the pair, whole or windows.
        T_world_camera: pose of the left eye.
        arm: whose gripper it is.
        T_world_tip: where the gripper is, within some millimetres.
        jaw_rad: opening of its jaws; a fragment held by them, or hanging from a finger's end, is no farther to the
            side.
    """
    T_camera_tip, rig = T_world_camera.inverse() @ T_world_tip, image.rig
    aside_m = ASIDE_M + arm.instrument.finger_length_m * float(np.sin(0.5 * max(jaw_rad, 0.0)))
    lower = np.array([-aside_m, -ASIDE_M, arm.tip_length_m - BEYOND_AXIS_M[1]])
    upper = np.array([aside_m, ASIDE_M, arm.tip_length_m - BEYOND_AXIS_M[0]])
    pick = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
    corners = T_camera_tip.apply(np.where(pick, upper, lower))
    if (corners[:, 2] <= 0).any():
        return False
    points = _red_points(image, corners)
    p_tip = T_camera_tip.inverse().apply(points)
    within = int(((p_tip >= lower) & (p_tip <= upper)).all(axis=-1).sum())
    return within * (float(corners[:, 2].mean()) / rig.left.fx) ** 2 >= MIN_AREA_M2


def _red_points(image: StereoImage, corners_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions (n, 3) of the red pixels in the left picture of a box, in the left eye's frame.

    A pixel is matched over the disparities of the box and of what may be behind it, so that each finds its own match.
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
