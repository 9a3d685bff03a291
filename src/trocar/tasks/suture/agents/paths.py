"""Motions along the dense joint paths of a suture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.arms.inverse import OUTER
from trocar.tasks.suture.planning.segments import minimum_jerk
from trocar.trajectory import Trajectory

KNOT_S = 0.020
"""Spacing of a motion's knots: two control periods."""
RUN_UP_M, RUN_UP_INSIDE_M = 1.0e-3, 0.3e-3
"""A corrected start of a path is approached from this far behind it, so that the outer joints have taken up their play
in the direction of the motion. Before the exit, this brings the needle's tip nearer to the surface, so it is less."""


def run_up(q: NDArray[np.float64], length_m: float, run_up_m: float) -> NDArray[np.float64]:
    """Return joints (6,) whose outer ones are this far behind the start of a path (k, 6) of this length.

    The wrist is as it is at the start. If it turned back and forth, it would lag behind the outer joints, so that the
    needle's tip would swing, and its cables would not come to rest where they were.
    """
    place = min(len(q) - 1, max(1, math.ceil(run_up_m / length_m * (len(q) - 1))))
    behind = q[0].copy()
    behind[:OUTER] -= run_up_m / (length_m * place / (len(q) - 1)) * (q[place] - q[0])[:OUTER]
    return behind


def along(q: NDArray[np.float64], seconds: float) -> Trajectory:
    """Return the minimum-jerk motion from rest to rest through a dense joint path (k, 6), k > 1."""
    count = max(2, math.ceil(seconds / KNOT_S))
    times = np.linspace(0.0, max(seconds, count * 1e-3), count + 1)
    tau = times / times[-1]
    share = minimum_jerk(tau)
    rate = 30 * tau**2 * (1 - tau) ** 2 / times[-1]
    path = CubicSpline(np.linspace(0.0, 1.0, len(q)), q)
    return Trajectory.hermite(times, path(share), rate[:, None] * path(share, 1))
