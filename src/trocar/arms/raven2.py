"""Raven II, left and right arm."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

from trocar.arms.instrument import RAVEN_GRIPPER, FingerMarks
from trocar.arms.model import ArmModel, Joint

# Raven II, modified DH. Row 4 as published has d = -0.47 m, which commutes with the roll and is added
# to the insertion here; the fixed +-90 deg of row 3 are about the same axis and are added to the roll. A small q3 means
# a deep instrument.
INSERTION_OFFSET_M = -0.47
WRIST_LENGTH_M = 0.013  # Raven instruments; 0.009 for da Vinci instruments on the adapter
TIP_LENGTH_M = 0.010  # jaw axis to the controlled point; the jaws end at 0.020
YELLOW, GREEN, BLUE, MAGENTA = (0.80, 0.62, 0.02), (0.02, 0.45, 0.10), (0.02, 0.14, 0.62), (0.50, 0.03, 0.48)
"""Four colours that differ from each other, from steel and from red tissue (assumed; Kehoe 2014, V-A.2 has four)."""

_DRIVE = 3.0, 1.0  # rad/s, rad/s^2: drive limits
_SLIDE = 0.1, 0.1  # m/s: surgeons' peak tip speed; m/s^2: assumed, no source

RAVEN2_LEFT = ArmModel(
    name="raven2-left",
    joints=(
        Joint("shoulder", 0.0, radians(90), *_DRIVE),
        Joint("elbow", radians(45), radians(135), *_DRIVE),
        Joint("insertion", 0.23, 0.56, *_SLIDE, prismatic=True),
        Joint("roll", radians(-182), radians(182), *_DRIVE),
        Joint("wrist_pitch", radians(-75), radians(75), *_DRIVE),
        Joint("wrist_yaw", radians(-90), radians(90), *_DRIVE),
    ),
    twists_rad=(0.0, radians(75), radians(128)),
    offsets=(radians(205), pi, INSERTION_OFFSET_M, pi / 2, 0.0, 0.0),
    wrist_sign=1,
    wrist_length_m=WRIST_LENGTH_M,
    tip_length_m=TIP_LENGTH_M,
    jaw=Joint("jaw", 0.0, radians(120), *_DRIVE),
    instrument=replace(RAVEN_GRIPPER, marks=FingerMarks((YELLOW, GREEN))),
    safe_depth_m=0.045,  # assumed, as on the dVRK: no source for Raven
)

RAVEN2_RIGHT = replace(
    RAVEN2_LEFT,
    name="raven2-right",
    instrument=replace(RAVEN_GRIPPER, marks=FingerMarks((BLUE, MAGENTA))),
    twists_rad=(pi, radians(75), radians(52)),
    offsets=(radians(25), 0.0, INSERTION_OFFSET_M, -pi / 2, 0.0, 0.0),
)
