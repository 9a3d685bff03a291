"""Arms with shifted joint zeros: the same arms, but with other joint values."""

from dataclasses import replace

import numpy as np

from trocar.arms import ArmModel

SHIFT = np.array([0.3, -0.2, 0.01, 0.4, 0.5, -0.6])
"""Shift of each joint's zero, rad and m; no two are alike."""


def recounted(arm: ArmModel, shift=SHIFT) -> ArmModel:
    """Return the arm with every joint's zero shifted: its ``q - shift`` is ``q`` of the given arm."""
    joints = tuple(
        replace(joint, lower=joint.lower - by, upper=joint.upper - by)
        for joint, by in zip(arm.joints, shift, strict=True)
    )
    return replace(arm, joints=joints, offsets=tuple((np.array(arm.offsets) + shift).tolist()))
