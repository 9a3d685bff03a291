"""Where the solids of an arm are: its instrument as capsules."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms.forward import frames
from trocar.arms.model import ArmModel
from trocar.geometry.capsules import Capsules

SOLIDS = ("shaft", "wrist", "left finger", "right finger")
"""What the capsules of :func:`capsules` stand for, in order."""


def capsules(arm: ArmModel, q: ArrayLike, jaw_rad: ArrayLike = 0.0) -> Capsules:
    """Return shaft, wrist and both fingers (:data:`SOLIDS`) as capsules in the arm's base: ends (..., 4, 2, 3) m.

    Each capsule holds the whole solid that it stands for.

    Args:
        arm: whose instrument.
        q: (..., 6) joints, rad and m.
        jaw_rad: (...,) opening between the fingers.
    """
    shape = arm.instrument
    poses = frames(arm, q)
    roll, pitch, yaw = (poses[..., k, :, :] for k in (4, 5, 6))
    jaw = np.broadcast_to(np.asarray(jaw_rad, dtype=np.float64), poses.matrix.shape[:-3])
    # the shaft is a cylinder that ends flat at the wrist: the round cap of its capsule starts one radius further up
    down = -arm.wrist_sign * np.array([0.0, 0.0, 1.0])
    parts = [
        (roll.apply(-shape.shaft_radius_m * down), roll.apply(-shape.shaft_length_m * down)),
        (pitch.translation_m, yaw.translation_m),
    ]
    for angle in (0.5 * jaw, -0.5 * jaw):  # the jaws point along y of frame 6 and turn about its z
        along = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], -1)
        parts.append((yaw.translation_m, yaw.apply(shape.finger_length_m * along)))
    ends = np.stack([np.stack(np.broadcast_arrays(*part), -2) for part in parts], -3)
    radii = [shape.shaft_radius_m, shape.wrist_radius_m, shape.finger_radius_m, shape.finger_radius_m]
    return Capsules(ends, np.array(radii))
