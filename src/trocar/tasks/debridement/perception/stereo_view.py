"""The perception of the debridement agents: what it returns, and where to look for a gripper."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoImage, StereoRig, StereoWindow, Window
from trocar.tasks.debridement.perception.fragments import find_fragments
from trocar.tasks.debridement.perception.gripper import find_gripper
from trocar.tasks.debridement.perception.held import is_holding
from trocar.tasks.debridement.perception.seen import SeenFragment, SeenGripper

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


class StereoView:
    """Fragments and grippers in a pair of pictures. A perception of your own has these methods.

    All take poses of the left eye as ``T_world_camera``, and pictures of whole eyes or of windows.
    """

    def fragments(
        self,
        image: StereoImage,
        T_world_camera: SE3,
        T_world_table: SE3,
        arms: Mapping[str, ArmModel] | None = None,
    ) -> list[SeenFragment]:
        """Return the fragments that both eyes see: on the table, in the receptacle, or between jaws."""
        return find_fragments(image, T_world_camera, T_world_table)

    def gripper(self, image: StereoImage, T_world_camera: SE3, arm: ArmModel) -> SeenGripper | None:
        """Return an arm's gripper from its marks, or None if they do not determine it."""
        return find_gripper(image, T_world_camera, arm)

    def gripper_window(
        self,
        T_world_tip_guess: SE3,
        T_world_camera: SE3,
        rig: StereoRig,
        margin_m: float = MARGIN_M,
        binning: int = 1,
    ) -> StereoWindow | None:
        """Return the pixels in which a gripper near this pose is seen, or None if both eyes look past it."""
        return gripper_window(T_world_tip_guess, T_world_camera, rig, margin_m, binning)

    def holding(self, image: StereoImage, T_world_camera: SE3, arm: ArmModel, T_world_tip: SE3, jaw_rad: float) -> bool:
        """Return whether something red is between the fingers, or hangs from them, in both eyes."""
        return is_holding(image, T_world_camera, arm, T_world_tip, jaw_rad)
