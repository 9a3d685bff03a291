"""The perception of the debridement agents: colour pictures of two eyes."""

from __future__ import annotations

from collections.abc import Mapping

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.perception.image import StereoImage, StereoRig, StereoWindow
from trocar.tasks.debridement.perception.fragments import find_fragments
from trocar.tasks.debridement.perception.gripper import find_gripper
from trocar.tasks.debridement.perception.held import is_holding
from trocar.tasks.debridement.perception.seen import SeenFragment, SeenGripper
from trocar.tasks.debridement.perception.windows import MARGIN_M, gripper_window


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
