"""How far from its inner waypoints a motion passes, and how far each joint may deviate there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, jacobian
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.limits import CHECK_STEP_S
from trocar.motion.path import TimedPath
from trocar.motion.problem import MotionProblem

CURVED = 1.05
"""Factor by which a joint may deviate further than the linear estimate, for tolerances of a millimetre."""


def passing_deviation(arm: ArmMotion, path: TimedPath, waypoint: int) -> tuple[float, float]:
    """Return how far from a waypoint the tip passes (m) and how far it is turned (rad).

    The distance is the greater of the one along ``up`` and the one sideways.
    """
    tip = fk(arm.model, path.trajectory(path.waypoint_times_s[waypoint]))
    wanted = fk(arm.model, arm.waypoints[waypoint])
    off = tip.translation_m - wanted.translation_m
    along = float(off @ arm.up)
    turned = np.linalg.norm((wanted.rotation.inverse() @ tip.rotation).log())
    return max(abs(along), float(np.linalg.norm(off - along * arm.up))), float(turned)


def sag_m(arm: ArmMotion, path: TimedPath, piece: int) -> float:
    """Return how far the tip sinks below the lower of two waypoints between them, along ``up`` at 1 kHz, m."""
    begin, end = path.waypoint_times_s[piece : piece + 2]
    times = np.linspace(begin, end, int(np.ceil((end - begin) / CHECK_STEP_S)) + 1)
    heights_m = fk(arm.model, path.trajectory(times)).translation_m @ arm.up
    ends_m = fk(arm.model, arm.waypoints[piece : piece + 2]).translation_m @ arm.up
    return float(ends_m.min() - heights_m.min())


def passed_over(arm: ArmMotion) -> list[int]:
    """Return the pieces on which the tip must not sag where waypoints have a tolerance.

    These are all pieces that are not straight and have an inner waypoint, except the first one of a moving start.
    """
    last = len(arm.waypoints) - 2
    if not last:
        return []
    return [piece for piece, straight in enumerate(arm.straight) if not (straight or (arm.moves and not piece))]


def joint_strays(arm: ArmMotion, problem: MotionProblem) -> NDArray[np.float64] | None:
    """Return how far (n, joints) each joint may be from each waypoint, rad and m; None if there is no tolerance.

    To first order in the tolerances, and a little more; infinite at a singular waypoint.
    """
    if not max(problem.waypoint_tolerance_m, problem.waypoint_tolerance_rad):
        return None
    strays = np.zeros_like(arm.waypoints)
    for index, point in enumerate(arm.waypoints[1:-1], start=1):
        try:
            inverse = np.linalg.inv(jacobian(arm.model, point))
        except np.linalg.LinAlgError:
            strays[index] = np.inf
            continue
        aside = np.hypot(1, 1) * problem.waypoint_tolerance_m * np.linalg.norm(inverse[:, :3], axis=1)
        turned = problem.waypoint_tolerance_rad * np.linalg.norm(inverse[:, 3:], axis=1)
        strays[index] = CURVED * (aside + turned)
    return strays
