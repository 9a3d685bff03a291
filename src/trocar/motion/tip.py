"""The tip's speed on a motion, and how far it faces away."""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.motion.arm_motion import ArmMotion
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

STEP_S = 0.02
"""Time between samples of the tip."""
WIDTH = 1e-6
"""Half step (rad, m) of the difference quotient for the tip's speed."""


def tip_speeds_m_s(arm: ArmMotion, q: Array, velocity: Array) -> Array:
    """Return the speeds (n,) of the tip at joints (n, 6) that move with velocities (n, 6)."""
    scale = WIDTH / np.maximum(1e-9, np.abs(velocity).max(axis=1, keepdims=True))
    ahead = fk(arm.model, np.stack([q + scale * velocity, q - scale * velocity])).translation_m
    return np.linalg.norm(ahead[0] - ahead[1], axis=1) / (2 * scale[:, 0])


def tip_use(arm: ArmMotion, motion: Trajectory) -> tuple[float, float]:
    """Return the greatest speed of the tip (m/s), and its greatest facing angle (rad), at 50 Hz and at all knots.

    Each is 0 if the arm has no such constraint.
    """
    if arm.max_tip_m_s == inf and arm.facing is None:
        return 0.0, 0.0
    times = np.union1d(motion.sample(STEP_S)[0], motion.times_s)
    q, speed, angle = motion(times), 0.0, 0.0
    if arm.max_tip_m_s < inf:
        speed = float(tip_speeds_m_s(arm, q, motion(times, 1)).max())
    if arm.facing is not None:
        angle = float(arm.facing.angle_rad(arm.T_world_base @ fk(arm.model, q)).max())
    return speed, angle
