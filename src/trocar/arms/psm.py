"""Patient-side manipulators of the da Vinci Research Kit with the Large Needle Driver."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

import numpy as np

from trocar.arms.instrument import LARGE_NEEDLE_DRIVER
from trocar.arms.model import ArmModel, Joint, MotionLimits

# Hwang et al. 2022, Fig. 8
L1_M = 0.4318  # remote centre to the carriage at full retraction
L2_M = 0.4162  # length of the instrument's shaft
L3_M = 0.0091  # wrist pitch axis to wrist yaw axis
L4_M = 0.0095  # wrist yaw axis to the point between the jaws that the paper controls; dVRK: 0, jaw tip: .0102

# dVRK trajectory limits, from its configuration
_ARM = radians(90), radians(90)  # speed per s, acceleration per s^2
_SLIDE = 0.2, 0.2
_WRIST = radians(1080), radians(720)

PSM_CLASSIC = ArmModel(
    name="psm-classic",
    joints=(
        Joint("yaw", radians(-91), radians(91), *_ARM),
        Joint("pitch", radians(-53), radians(53), *_ARM),
        Joint("insertion", 0.0, 0.24, *_SLIDE, prismatic=True),
        Joint("roll", radians(-260), radians(260), *_WRIST),
        Joint("wrist_pitch", radians(-80), radians(80), *_WRIST),
        Joint("wrist_yaw", radians(-80), radians(80), *_WRIST),
    ),
    twists_rad=(pi / 2, -pi / 2, pi / 2),
    offsets=(pi / 2, -pi / 2, L2_M - L1_M, 0.0, 0.0, 0.0),
    wrist_sign=-1,
    wrist_length_m=L3_M,
    tip_length_m=L4_M,
    # range: Large Needle Driver; speed: 6 rad/s, as in the paper's runs; acceleration: that of the wrist
    jaw=Joint("jaw", radians(-40), radians(80), max_speed=6.0, max_acceleration=radians(720)),
    instrument=LARGE_NEEDLE_DRIVER,
    safe_depth_m=0.045,  # sawIntuitiveResearchKit, SafeDistanceFromRCM (Cartesian control)
    # 8 mm instruments, joint from actuator: roll, wrist pitch, wrist yaw, jaw (the dVRK's coupling matrix)
    coupling=(
        (-1.5632, 0.0, 0.0, 0.0),
        (0.0, 1.0186, 0.0, 0.0),
        (0.0, -0.8306, 0.6089, 0.6089),
        (0.0, 0.0, -1.2177, 1.2177),
    ),
)

PSM_SI = replace(
    PSM_CLASSIC,
    name="psm-si",
    joints=(
        Joint("yaw", radians(-170), radians(170), *_ARM),
        Joint("pitch", radians(-72.5), radians(74.5), *_ARM),
        Joint("insertion", 0.0, 0.29, *_SLIDE, prismatic=True),
        *PSM_CLASSIC.joints[3:],
    ),
)

MOTION_LIMITS: dict[str, MotionLimits] = {
    # Hwang et al. 2022, the runs of the study: 2 [pi pi .2 6pi 6pi 6pi] and 2 [pi pi .2 4pi 4pi 4pi]
    "paper": MotionLimits(
        2 * np.array([pi, pi, 0.2, 6 * pi, 6 * pi, 6 * pi]), 2 * np.array([pi, pi, 0.2, 4 * pi, 4 * pi, 4 * pi])
    ),
    "dvrk": PSM_CLASSIC.motion_limits,
}
"""Named motion limits of the PSM: those of the paper's runs, and those of the dVRK controller's trajectories."""
