"""Where the gripper really is, from kinematics at all times and detections now and then (Kehoe 2014, V-A.2)."""

from trocar.tasks.debridement.pose.error_field import ErrorField
from trocar.tasks.debridement.pose.error_filter import ErrorFilter, FilterSettings, PoseEstimate
from trocar.tasks.debridement.pose.estimators import HeldError, PaperAdjustment, PoseEstimator, RawKinematics
from trocar.tasks.debridement.pose.pairs import PosePairs, read_pairs

__all__ = [
    "ErrorField",
    "ErrorFilter",
    "FilterSettings",
    "HeldError",
    "PaperAdjustment",
    "PoseEstimate",
    "PoseEstimator",
    "PosePairs",
    "RawKinematics",
    "read_pairs",
]
