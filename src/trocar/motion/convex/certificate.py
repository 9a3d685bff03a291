"""Whether a path meets its requirements, between its samples too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.motion.arm_motion import JOINTS, ArmMotion
from trocar.motion.clearance import Clearance, swept_clearance
from trocar.motion.convex.scene import joint_path
from trocar.motion.moving_arm import MovingArm
from trocar.motion.problem import MotionProblem
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

CERTIFIED_M = 1e-6
"""A certified distance may fall short of the required one by this: a tenth of what the check allows."""
THROUGH_M = 3e-3
"""A path whose distance falls short by this much, though not at the planned places, passes through something."""


def clearance(problem: MotionProblem, motion: Trajectory) -> Clearance:
    """Return how near the arms come to each other and to everything else on a motion of all joints.

    If nothing else moves, the motion may be a path with any timing. From its start until everything rests.
    """
    arms = {
        name: MovingArm(arm.model, joint_path(motion, k), arm.T_world_base, jaw_rad=arm.jaw_rad)
        for k, (name, arm) in enumerate(problem.arms.items())
    }
    return swept_clearance(
        arms,
        others=problem.others,
        obstacles=problem.obstacles,
        span_s=(0.0, max(motion.duration_s, *(arm.end_s for arm in problem.others.values()), 0.0)),
        enough_m=problem.min_distance_m,
        too_near_m=problem.min_distance_m - THROUGH_M,
        resolution_m=CERTIFIED_M,
    )


def in_range(arms: tuple[ArmMotion, ...], q: Array, slack: float) -> bool:
    """Return whether joints keep their ranges at evenly spaced places q (n, joints), with a parabola in between."""
    for k, arm in enumerate(arms):
        part = q[:, JOINTS * k : JOINTS * (k + 1)]
        beyond = slack * (arm.model.upper - arm.model.lower) - np.abs(np.diff(part, n=2, axis=0)).max(axis=0) / 8
        if np.any(part.min(axis=0) < arm.model.lower - beyond) or np.any(part.max(axis=0) > arm.model.upper + beyond):
            return False
    return True


def faces(arms: tuple[ArmMotion, ...], q: Array) -> bool:
    """Return whether the tips face what they should at evenly spaced places q (n, joints), and as far as known between.

    The first and the last are given, so they are not checked here.
    """
    for k, arm in enumerate(arms):
        if arm.facing is None:
            continue
        angles = arm.facing.angle_rad(arm.T_world_base @ fk(arm.model, q[:, JOINTS * k : JOINTS * (k + 1)]))
        if angles[1:-1].max() + np.abs(np.diff(angles, n=2)).max() / 8 > arm.facing.max_rad:
            return False
    return True
