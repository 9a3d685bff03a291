"""Arms that work through a remote centre of motion: models and their kinematics."""

from trocar.arms.forward import fk, frames, jacobian, limit_violations, manipulability, wrist_depth_m
from trocar.arms.instrument import LARGE_NEEDLE_DRIVER, RAVEN_GRIPPER, FingerMarks, Instrument
from trocar.arms.inverse import ik, ik_branches, ik_near, ik_unbounded, ik_with_fixed_wrist
from trocar.arms.model import BRANCHES, ArmModel, Branch, Joint, MotionLimits
from trocar.arms.psm import MOTION_LIMITS, PSM_CLASSIC, PSM_SI
from trocar.arms.raven2 import RAVEN2_LEFT, RAVEN2_RIGHT
from trocar.arms.solids import SOLIDS, capsules
from trocar.registry import Registry

ARMS: Registry[ArmModel] = Registry(
    "arm", "trocar.arms", {arm.name: arm for arm in (PSM_CLASSIC, PSM_SI, RAVEN2_LEFT, RAVEN2_RIGHT)}
)
"""All robot types by name; tests run over it, so every registered type is tested."""

__all__ = [
    "ARMS",
    "BRANCHES",
    "LARGE_NEEDLE_DRIVER",
    "MOTION_LIMITS",
    "PSM_CLASSIC",
    "PSM_SI",
    "RAVEN2_LEFT",
    "RAVEN2_RIGHT",
    "RAVEN_GRIPPER",
    "SOLIDS",
    "ArmModel",
    "Branch",
    "FingerMarks",
    "Instrument",
    "Joint",
    "MotionLimits",
    "capsules",
    "fk",
    "frames",
    "ik",
    "ik_branches",
    "ik_near",
    "ik_unbounded",
    "ik_with_fixed_wrist",
    "jacobian",
    "limit_violations",
    "manipulability",
    "wrist_depth_m",
]
