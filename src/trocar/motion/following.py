"""Motions that follow a goal which is given anew each period, within limits."""

from __future__ import annotations

import numpy as np

from trocar.arms import MotionLimits
from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory


def step_towards(
    goal: Array, goal_velocity: Array, q: Array, velocity: Array, limits: MotionLimits, period_s: float
) -> Trajectory:
    """Return a motion that follows a goal for a period, as near as the limits allow, and comes to rest after that.

    A goal that itself keeps the limits is followed, as the quadratic B-spline of its periods does: exactly where it is
    at rest or its speed is constant, and half a period late. One that jumps, or was not heard of for a while, is caught
    up with as fast as can be without overshoot. The motion's end takes place only if no other takes over: a stream that
    breaks off ends within limits.

    Args:
        goal: (joints,) a period from now.
        goal_velocity: (joints,) with which it moves during the period.
        q: (joints,) now.
        velocity: (joints,) now.
        limits: of the arm.
        period_s: until another motion takes over.
    """
    change = limits.acceleration * period_s
    point = q + velocity * period_s / 2  # of the B-spline
    off = goal - (point + goal_velocity * period_s)
    # both would stop at the same place, braking as hard as the limits allow: so nothing is overshot if the goal does
    wanted = _speed_over(off + _stopped_after(goal_velocity, change, period_s), change, period_s)
    after = np.clip(np.clip(wanted, velocity - change, velocity + change), -limits.velocity, limits.velocity)
    stop_s = max(float((np.abs(after) / limits.acceleration).max()), period_s)
    end = q + (velocity + after) * period_s / 2
    tick = np.stack([(after - velocity) / (2 * period_s), velocity, q])
    stop = np.stack([-after / (2 * stop_s), after, end])
    return Trajectory(np.array([0.0, period_s, period_s + stop_s]), np.stack([tick, stop], axis=1))


def _stopped_after(velocity: Array, change: Array, period_s: float) -> Array:
    """Return how far (joints,) whole periods at speeds v, v - change, v - 2 change ... lead, until they are at rest."""
    steps = np.abs(velocity) / change
    n = np.floor(steps)
    return np.sign(velocity) * change * period_s * (n + 1) * (steps - n / 2)


def _speed_over(distance: Array, change: Array, period_s: float) -> Array:
    """Return the speed (joints,) that is at rest after this distance: the inverse of ``_stopped_after``."""
    share = np.abs(distance) / (change * period_s)
    n = np.floor((np.sqrt(1 + 8 * share) - 1) / 2)
    return np.sign(distance) * change * (share / (n + 1) + n / 2)
