"""How far a motion may be off, and how straight it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, jacobian
from trocar.geometry import SE3, SO3
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.limits import CHECK_STEP_S
from trocar.motion.path import TimedPath
from trocar.motion.problem import MotionProblem

SHORT_M = 1e-6
"""A piece whose ends are closer than this only rotates; the rotation then tells how much of it is done."""


def line_deviation(motion: ArmMotion, path: TimedPath, piece: int) -> tuple[float, float]:
    """Return how far the tip deviates from the line between two waypoints (m), and from the shortest turn (rad).

    At 1 kHz. At each instant the projection of the tip on the line tells how much of the piece is done, and so how far
    the tip should have turned.

    Args:
        motion: whose waypoints.
        path: when it passes them.
        piece: index; between the waypoints of this index and the next.
    """
    begin, end = fk(motion.model, motion.waypoints[piece]), fk(motion.model, motion.waypoints[piece + 1])
    tips = _tips(motion, path, piece)
    line, turn = end.translation_m - begin.translation_m, (begin.rotation.inverse() @ end.rotation).log()
    gone, turned = tips.translation_m - begin.translation_m, (begin.rotation.inverse() @ tips.rotation).log()
    if np.linalg.norm(line) > SHORT_M:
        done = gone @ line / (line @ line)
    else:
        done = turned @ turn / max(float(turn @ turn), 1e-12)
    done = np.clip(done, 0.0, 1.0)[:, None]
    still_to_turn = (SO3.exp(done * turn).inverse() @ SO3.exp(turned)).log()
    off_m, off_rad = np.linalg.norm(gone - done * line, axis=1), np.linalg.norm(still_to_turn, axis=1)
    return float(off_m.max()), float(off_rad.max())


def vertical_deviation_m(motion: ArmMotion, path: TimedPath) -> float:
    """Return how far the tip deviates from the verticals of a transfer, along ``up``, at 1 kHz.

    From the one through its first waypoint while it lifts off, on the first piece; from the one through its last
    waypoint while it lowers, on the last piece.
    """
    deviations = []
    for piece, foot in ((0, 0), (len(motion.waypoints) - 2, -1)):
        off = _tips(motion, path, piece).translation_m - fk(motion.model, motion.waypoints[foot]).translation_m
        deviations.append(np.linalg.norm(off - (off @ motion.up)[:, None] * motion.up, axis=1).max())
    return float(max(deviations))


def _tips(motion: ArmMotion, path: TimedPath, piece: int) -> SE3:
    """Return the poses of the tip on a piece, at 1 kHz and at both ends."""
    begin, end = path.waypoint_times_s[piece : piece + 2]
    times: NDArray[np.float64] = np.linspace(begin, end, int(np.ceil((end - begin) / CHECK_STEP_S)) + 1)
    return fk(motion.model, path.trajectory(times))


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
