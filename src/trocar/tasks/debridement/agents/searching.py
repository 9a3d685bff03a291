"""Brings an arm into view, however wrong its kinematics are."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from trocar.geometry import SE3
from trocar.tasks.debridement.agents.motion_asked import Asked
from trocar.tasks.debridement.agents.movers import ArmStopped, NoWay
from trocar.tasks.debridement.agents.raven_arm import RavenArm

SEARCH_M = (
    (0.0, 0.0, 0.0),
    (0.0, 0.0, -0.02),
    (-0.02, 0.0, -0.02),
    (-0.04, 0.0, -0.02),
    (-0.02, 0.02, -0.04),
    (-0.02, -0.03, -0.02),
    (0.0, -0.03, 0.0),
    (-0.04, 0.03, 0.01),
    (-0.02, 0.0, 0.03),
    (0.02, 0.0, 0.0),
)
"""Displacements that an unseen arm tries, one after the other: down and towards the middle first (x), then across and
up. Its true position is unknown; if it were low, it would be in the picture."""


class NotSeen(ArmStopped):
    """No camera sees the gripper, wherever it is moved."""


async def come_into_sight(arm: RavenArm) -> None:
    """Get the gripper seen once.

    Raises:
        NotSeen: it is not seen anywhere.
    """
    T_world_start = arm.robot.T_world_tip(arm.name)
    for x, y, z in SEARCH_M:
        off = np.array([arm.side * x, y, z])
        goal = SE3.from_parts(T_world_start.rotation, T_world_start.translation_m + off)
        with suppress(NoWay):
            await arm.mover.step(arm.name, Asked(goal, arm.s.tip_speed_m_s, straight=True), arm.s.step_m)
            await arm.settle()
            await arm.eyes.look(arm.name)
        if arm.robot.age_s(arm.name) < np.inf:
            return
    raise NotSeen(f"no camera sees the gripper of arm {arm.name!r}")
