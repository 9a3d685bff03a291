"""How far a motion may be off, and how straight it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.geometry import SE3, SO3
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.limits import CHECK_STEP_S
from trocar.motion.path import TimedPath

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
