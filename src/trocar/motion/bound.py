"""A duration that no motion through the waypoints can beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import MotionLimits


def shortest_rest_to_rest_s(distance: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> NDArray[np.float64]:
    """Return the least time from rest to rest over a distance >= 0: a trapezoid of velocity, s."""
    distance, velocity, acceleration = (np.asarray(x, dtype=np.float64) for x in (distance, velocity, acceleration))
    ramp = velocity**2 / acceleration
    bang_bang = 2 * np.sqrt(distance / acceleration)
    return np.where(distance <= ramp, bang_bang, distance / velocity + velocity / acceleration)


def duration_bound_s(waypoints: ArrayLike, limits: MotionLimits) -> float:
    """Return a lower bound of the duration of any motion from rest to rest through the waypoints, s.

    Each joint alone is a double integrator that must visit its values in order, at any velocity. Where it
    turns round it must stop, at the waypoint or beyond; where it does not, a waypoint costs nothing. So its
    least time is the sum of rest-to-rest times over the monotone runs, exactly, and no motion of all joints
    beats the slowest one. The bound ignores that the joints pass a waypoint together, and the path between
    waypoints.

    Args:
        waypoints: (n, joints), rad or m.
        limits: bounds of velocity and acceleration.
    """
    q = np.asarray(waypoints, dtype=np.float64)
    runs = (_monotone_runs(column) for column in q.T)
    times = [
        shortest_rest_to_rest_s(run, v, a).sum()
        for run, v, a in zip(runs, limits.velocity, limits.acceleration, strict=True)
    ]
    return float(max(times))


def _monotone_runs(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of the monotone runs of a sequence."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    if not len(steps):
        return np.zeros(1)
    turns = np.flatnonzero(np.diff(np.sign(steps))) + 1
    return np.abs([run.sum() for run in np.split(steps, turns)])
