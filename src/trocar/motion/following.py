"""Motions within limits that follow a goal given anew each period."""

from __future__ import annotations

import numpy as np

from trocar.arms import MotionLimits
from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory


def step_towards(
    goal: Array, goal_velocity: Array, q: Array, velocity: Array, limits: MotionLimits, period_s: float
) -> Trajectory:
    """Return a motion that follows a goal for a period, as near as the limits allow, and comes to rest after that.

    If the goal itself keeps the limits, the motion is the quadratic B-spline with the goals as control points: half a
    period late, and exact where the goal rests or moves at constant speed. If the goal jumps, or was not updated for a
    while, the motion catches up as fast as possible without overshoot. The braking at the end is played only if no
    other motion takes over, so a stream that breaks off ends within limits.

    Args:
        goal: (joints,) goal a period from now.
        goal_velocity: (joints,) velocity of the goal during the period.
        q: (joints,) position now.
        velocity: (joints,) velocity now.
        limits: of the arm.
        period_s: time until another motion takes over.
    """
    change = limits.acceleration * period_s
    point = q + velocity * period_s / 2  # control point of the B-spline
    off = goal - (point + goal_velocity * period_s)
    # from the wanted speed, hardest braking ends where that of the goal would end: a goal that stops is not overshot
    wanted = _speed_over(off + _stopped_after(goal_velocity, change, period_s), change, period_s)
    after = np.clip(np.clip(wanted, velocity - change, velocity + change), -limits.velocity, limits.velocity)
    stop_s = max(float((np.abs(after) / limits.acceleration).max()), period_s)
    end = q + (velocity + after) * period_s / 2
    tick = np.stack([(after - velocity) / (2 * period_s), velocity, q])
    stop = np.stack([-after / (2 * stop_s), after, end])
    return Trajectory(np.array([0.0, period_s, period_s + stop_s]), np.stack([tick, stop], axis=1))


def _stopped_after(velocity: Array, change: Array, period_s: float) -> Array:
    """Return the distance (joints,) of whole periods at speeds v, v - change, v - 2 change, ... until rest."""
    steps = np.abs(velocity) / change
    n = np.floor(steps)
    return np.sign(velocity) * change * period_s * (n + 1) * (steps - n / 2)


def _speed_over(distance: Array, change: Array, period_s: float) -> Array:
    """Return the speed (joints,) from which braking covers this distance: the inverse of ``_stopped_after``."""
    share = np.abs(distance) / (change * period_s)
    n = np.floor((np.sqrt(1 + 8 * share) - 1) / 2)
    return np.sign(distance) * change * (share / (n + 1) + n / 2)
