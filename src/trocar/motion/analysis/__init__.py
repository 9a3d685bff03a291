"""Analysis of recorded motions: velocities, accelerations and jerk of joints and tool tip from measured positions."""

from trocar.motion.analysis.derivatives import Derivatives, JointAnalysis, analyse, analyse_joints, savitzky_golay
from trocar.motion.analysis.huber import Motion, estimate
from trocar.motion.analysis.table import JointTable, read_joint_table

__all__ = [
    "Derivatives",
    "JointAnalysis",
    "JointTable",
    "Motion",
    "analyse",
    "analyse_joints",
    "estimate",
    "read_joint_table",
    "savitzky_golay",
]
