"""Arms whose joints are counted from elsewhere: they are the same arms, only the numbers of their joints differ."""

from dataclasses import replace

import numpy as np

from trocar.arms import ArmModel

SHIFT = np.array([0.3, -0.2, 0.01, 0.4, 0.5, -0.6])
"""Rad, and m of the insertion: no two alike."""


def recounted(arm: ArmModel, shift=SHIFT) -> ArmModel:
    """Return an arm with every joint's zero moved by so much: ``q - shift`` of it is ``q`` of the other."""
    joints = tuple(
        replace(joint, lower=joint.lower - by, upper=joint.upper - by)
        for joint, by in zip(arm.joints, shift, strict=True)
    )
    return replace(arm, joints=joints, offsets=tuple((np.array(arm.offsets) + shift).tolist()))
