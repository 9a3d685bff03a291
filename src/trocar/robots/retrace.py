"""The way back: an arm returns along the path that it came, which was free of obstacles."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory

APART = 5e-3
"""Points of the path closer together than this (rad, insertion times ``WEIGHT``) are left out: a hand trembles."""
RATE = 0.4
"""Mean speed of the fastest joint, rad/s (assumed: gentle); a guard slows down what its limits do not allow."""
WEIGHT = np.array([1.0, 1.0, 5.0, 1.0, 1.0, 1.0])
"""A metre of the insertion counts as 5 rad: the tip is .1 to .2 m from the remote centre."""
KNOTS_S = 0.04
LEAST_S = 0.5
"""Minimum duration."""


def apart(q: Array, other: Array) -> bool:
    """Return whether two configurations (6,) are far enough apart for both to be points of a path."""
    return bool(np.abs((q - other) * WEIGHT).max() > APART)


def retraced(path_q: Array) -> Trajectory:
    """Return the motion from the end of a joint path (n, 6), n > 1, back to its start, from rest to rest.

    Args:
        path_q: where the arm was, rad and m; its two ends differ.
    """
    kept = [path_q[-1]]
    for q in path_q[-2:0:-1]:
        if apart(q, kept[-1]):
            kept.append(q)
    way = np.array([*kept, path_q[0]])
    steps = np.maximum(np.abs(np.diff(way, axis=0) * WEIGHT).max(1), 1e-6)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    duration_s = max(LEAST_S, along[-1] / RATE)
    times = np.linspace(0.0, duration_s, max(4, int(np.ceil(duration_s / KNOTS_S))) + 1)
    u = times / duration_s
    path = PchipInterpolator(along, way)
    share, rate = along[-1] * u**2 * (3 - 2 * u), along[-1] * 6 * u * (1 - u) / duration_s
    return Trajectory.hermite(times, path(share), path(share, 1) * rate[:, None])
