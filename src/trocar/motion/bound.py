"""A duration that no motion through the waypoints can beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import MotionLimits

ROUNDING = 1e-12
"""Share of a distance that counts as rounding."""


def shortest_rest_to_rest_s(distance: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> NDArray[np.float64]:
    """Return the least time from rest to rest over a distance >= 0: a trapezoid of velocity, s."""
    distance, velocity, acceleration = (np.asarray(x, dtype=np.float64) for x in (distance, velocity, acceleration))
    ramp = velocity**2 / acceleration
    bang_bang = 2 * np.sqrt(distance / acceleration)
    return np.where(distance <= ramp, bang_bang, distance / velocity + velocity / acceleration)


def shortest_to_rest_s(
    distance: ArrayLike, start_velocity: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> NDArray[np.float64]:
    """Return the least time from a moving start to rest at a signed distance, s.

    If braking at once stops short of the goal, the motion is a trapezoid of velocity cut off at its start; if it
    overshoots or leads away, the joint brakes and comes back from rest.

    Args:
        distance: to go, rad or m, of either sign.
        start_velocity: per second, of either sign, within the limit.
        velocity: greatest, above 0.
        acceleration: greatest, above 0.
    """
    d, v0, v, a = (np.asarray(x, dtype=np.float64) for x in (distance, start_velocity, velocity, acceleration))
    braking_s, stop = np.abs(v0) / a, v0 * np.abs(v0) / (2 * a)
    missed = np.abs(d - stop)
    # if braking ends at the goal, the root of a rounding error would cost microseconds
    missed = np.where(missed <= ROUNDING * (np.abs(d) + np.abs(stop)), 0.0, missed)
    back = braking_s + shortest_rest_to_rest_s(missed, v, a)
    # continuing saves the part of the ramp already done, as if the joint had started earlier from rest
    behind = v0**2 / (2 * a)
    on = shortest_rest_to_rest_s(np.abs(d) + behind, v, a) - braking_s
    return np.where((d - stop) * v0 > 0, on, back)


def duration_bound_s(
    waypoints: ArrayLike,
    limits: MotionLimits,
    start_velocity: ArrayLike | None = None,
) -> float:
    """Return a lower bound of the duration of any motion through the waypoints to rest at the last, s.

    Each joint alone is a double integrator that must visit its values in order, at any velocity. Where it reverses it
    must stop, at the waypoint or beyond; elsewhere, a waypoint costs nothing. So its least time is the sum of
    rest-to-rest times over the monotone runs, exactly, and no motion of all joints beats the slowest one. A joint with
    a moving start first reverses where its run ends, or at the earliest point where it can stop, if that is further.
    The bound ignores that the joints pass a waypoint together, the path between waypoints, jerk, and whatever is in the
    way.

    >>> plan = plan_through(arm, waypoints, limits)
    >>> duration_bound_s(waypoints, limits) == plan.bound_s < plan.duration_s
    True

    Args:
        waypoints: (n, joints), rad or m.
        limits: bounds of velocity and acceleration.
        start_velocity: (joints,) at the first waypoint, per second; None: at rest.
    """
    q = np.asarray(waypoints, dtype=np.float64)
    v0 = np.zeros(q.shape[1]) if start_velocity is None else np.asarray(start_velocity, dtype=np.float64)
    joints = zip(q.T, v0, limits.velocity, limits.acceleration, strict=True)
    return max(_least_s(values, start, v, a) for values, start, v, a in joints)


def _least_s(values: NDArray[np.float64], v0: float, velocity: float, acceleration: float) -> float:
    """Return the least time in which one joint visits its values in order and rests at the last."""
    moving_s, values = 0.0, values - values[0]
    if v0:
        ahead = np.sign(v0) * np.diff(values) >= 0
        last = len(ahead) if ahead.all() else int(np.argmin(ahead))  # of the run in the direction of the velocity
        end, stop = values[last], v0 * abs(v0) / (2 * acceleration)
        near = abs(stop - end) <= ROUNDING * (abs(stop) + abs(end))
        turn = end if near or abs(end) > abs(stop) else stop
        moving_s = float(shortest_to_rest_s(turn, v0, velocity, acceleration))
        values = np.concatenate([[turn], values[last:]])
    return moving_s + float(shortest_rest_to_rest_s(_monotone_runs(values), velocity, acceleration).sum())


def _monotone_runs(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of the monotone runs of a sequence; reversals as small as rounding are ignored."""
    steps = np.diff(values)
    steps = steps[np.abs(steps) > ROUNDING * np.abs(values).max()]
    if not len(steps):
        return np.zeros(1)
    turns = np.flatnonzero(np.diff(np.sign(steps))) + 1
    return np.abs([run.sum() for run in np.split(steps, turns)])
