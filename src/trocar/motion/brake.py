"""Coming to rest in the middle of a motion: on its path, within the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trocar.arms import MotionLimits
from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory

STEP_S, MIN_STEP_S, MAX_CHANGE = 1e-3, 5e-5, 0.02  # integration steps: longest, shortest, and wanted change of the rate
HEADROOM = 0.99  # share of the acceleration limits that braking uses: a margin for what lies between two steps
PATIENCE, GRACE_S = 2.0, 0.1  # braking on the path may take this factor longer than independent joints, plus this
STILL = 1e-12


@dataclass(frozen=True, eq=False)
class Brake:
    """How a motion comes to rest."""

    times_s: Array  # (n,) since braking began
    path_s: Array  # (n,) time along the trajectory
    rate: Array  # (n,) how fast it runs; the last is 0
    # if the path is left, the motion of the joints by themselves, from time 0; else None
    off_path: Trajectory | None = None

    @property
    def duration_s(self) -> float:
        """Return the time until rest."""
        return float(self.times_s[-1])

    def at(self, since_s: Array) -> tuple[Array, Array]:
        """Return the time along the path (n,) and its rate at times (n,) since braking began.

        Between two steps the rate is linear, so the time along the path is quadratic; a linear time would make the arm
        rattle.
        """
        row = np.clip(np.searchsorted(self.times_s, since_s, side="right") - 1, 0, len(self.times_s) - 1)
        rate = np.interp(since_s, self.times_s, self.rate)
        within_s = np.clip(since_s, 0.0, self.times_s[-1]) - self.times_s[row]
        return self.path_s[row] + 0.5 * (self.rate[row] + rate) * within_s, rate


def brake(trajectory: Trajectory, path_s: float, limits: MotionLimits, lower: Array, upper: Array) -> Brake:
    """Return how to come to rest from the time ``path_s`` of a motion, as fast as the limits allow.

    The arm stays on its path; only the time ``s`` along it slows down. Every joint accelerates by
    ``q' s'' + q'' s'^2``, so its limits bound ``s''`` from below; ``s'' = 0`` is always allowed. If a joint that is
    already braking as hard as it can would delay the others for long, the joints stop independently, off the path, if
    their ranges (joints,) from ``lower`` to ``upper`` allow it.
    """
    on_path = _along_path(trajectory, path_s, limits)
    velocity = trajectory(path_s, 1)
    alone_s = float(np.max(np.abs(velocity) / (HEADROOM * limits.acceleration)))
    if on_path.duration_s <= PATIENCE * alone_s + GRACE_S:
        return on_path
    q = trajectory(path_s)
    end = q + 0.5 * alone_s * velocity
    if (end < lower).any() or (end > upper).any():
        return on_path
    curve = np.stack([-0.5 * velocity / alone_s, velocity, q])[:, None]
    times = np.array([0.0, alone_s])
    return Brake(times, np.full(2, path_s), np.zeros(2), Trajectory(times, curve))


def _along_path(trajectory: Trajectory, path_s: float, limits: MotionLimits) -> Brake:
    """Return the fastest braking on the path, by slowing down the trajectory's time.

    An arm that has only just started can stop within milliseconds; the steps are then that short.
    """
    end_s = float(trajectory.times_s[-1])
    reach = HEADROOM * limits.acceleration
    since, s, rate = 0.0, path_s, 1.0
    rows = [(since, s, rate)]
    while rate > 0.0 and s < end_s - STILL:
        ahead = np.array([s, min(end_s, s + rate * STEP_S)])  # within the step too, since there may be a knot
        push = _least_push(trajectory(ahead, 1), trajectory(ahead, 2), reach, rate)
        step_s = max(MIN_STEP_S, min(STEP_S, MAX_CHANGE / max(-push, STILL)))
        slower = rate + push * step_s
        if slower < 0.0:
            step_s, slower = rate / -push, 0.0
        since, s = since + step_s, min(end_s, s + 0.5 * (rate + slower) * step_s)
        rate = slower
        rows.append((since, s, rate))
    rows[-1] = (*rows[-1][:2], 0.0)
    return Brake(*np.array(rows).T)


def _least_push(velocity: Array, acceleration: Array, reach: Array, rate: float) -> float:
    """Return the least ``s''`` (at most 0) that keeps all acceleration limits at the rows (k, joints)."""
    carried = acceleration * rate * rate
    moves = np.abs(velocity) > STILL
    divisor = np.where(moves, velocity, 1.0)
    bounds = np.minimum((-reach - carried) / divisor, (reach - carried) / divisor)
    return min(0.0, float(np.max(np.where(moves, bounds, -1.0 / STEP_S))))
