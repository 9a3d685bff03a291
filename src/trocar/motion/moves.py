"""Simple moves in joint space: from rest along a straight line, or to rest from a moving start."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms import MotionLimits
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite
from trocar.motion.double_integrator import (
    NO_WAY,
    STILL,
    joined,
    phases_to_rest,
    shortest_rest_to_rest_s,
    shortest_to_rest_s,
)
from trocar.motion.limits import KEPT
from trocar.trajectory import Trajectory

HOLD_S = 0.01  # duration of a move to where the arm already is: one control period of the dVRK
ON_LINE = 1e-9  # share of the velocity limits by which a velocity may miss the line to the goal


def rest_to_rest(q0: ArrayLike, q1: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return the shortest motion along the straight line in joint space: a trapezoid of velocity.

    >>> arm, limits = ARMS["psm-classic"], MOTION_LIMITS["paper"]
    >>> round(rest_to_rest(arm.middle, arm.middle + 0.05, limits).duration_s, 3)
    0.707

    Args:
        q0: (joints,) start, rad or m.
        q1: (joints,) end.
        limits: bounds of velocity and acceleration.
    """
    start, end = (_joint_values(name, q, limits) for name, q in (("start", q0), ("end", q1)))
    step = _step(start, end)
    if not step.any():
        return Trajectory(np.array([0.0, HOLD_S]), start[None, None])
    times, share, speed, push = trapezoid(*_along(step, limits))
    coefficients = np.stack([np.outer(push / 2, step), np.outer(speed, step), start + np.outer(share, step)])
    return Trajectory(times, coefficients)


def move_to(q: ArrayLike, velocity: ArrayLike, q_goal: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return a short motion from a moving start to rest at the goal: to replace a running motion.

    If the arm rests, or moves along the straight line in joint space to the goal (or away from it), the motion stays on
    that line and takes the least time on it; from rest it is ``rest_to_rest``. Otherwise each joint moves on its own,
    in the time that the slowest one needs, which no motion beats, and with the least acceleration for that time. A
    joint overshoots its goal only if it cannot stop before it.

    >>> going = rest_to_rest(arm.middle, arm.middle + 0.05, limits)
    >>> back = move_to(going(0.3), going(0.3, 1), arm.middle, limits)
    >>> round(back.duration_s, 3)
    0.9

    Args:
        q: (joints,) where it is, rad or m.
        velocity: (joints,) its velocity there, per second.
        q_goal: (joints,) where it comes to rest.
        limits: bounds of velocity and acceleration.

    Raises:
        TrocarError: values that are not finite or a velocity beyond its limit. The ranges of the joints are
            not checked: an arm that moves fast towards the end of a range cannot be kept from leaving it.
    """
    given = (("start", q), ("velocity at the start", velocity), ("goal", q_goal))
    start, v, goal = (_joint_values(name, values, limits) for name, values in given)
    if np.any(np.abs(v) > KEPT * limits.velocity):
        problem = f"starts with velocities {v.tolist()} breaks the limits {limits.velocity.tolist()}"
        raise InvalidInput("a move that", problem, "slow down")
    if np.all(np.abs(v) <= STILL * limits.velocity):
        return rest_to_rest(start, goal, limits)
    step = _step(start, goal)
    rate = float(v @ step / (step @ step)) if step.any() else 0.0
    if step.any() and np.all(np.abs(v - rate * step) <= ON_LINE * limits.velocity):
        top, push = _along(step, limits)
        seconds = float(shortest_to_rest_s(1.0, rate, top, push))
        line = phases_to_rest(1.0, rate, seconds, top, push)
        return joined(start, v, [[(t, a * dq) for t, a in line] for dq in step], seconds)
    seconds = float(shortest_to_rest_s(step, v, limits.velocity, limits.acceleration).max())
    joints = zip(step, v, limits.velocity, limits.acceleration, strict=True)
    return joined(start, v, [phases_to_rest(d, v0, seconds, top, push) for d, v0, top, push in joints], seconds)


def trapezoid(velocity: float, acceleration: float) -> tuple[Array, Array, Array, Array]:
    """Return knots (n + 1,), and pieces' start, speed and acceleration (n,), of the shortest move from 0 to 1."""
    total = float(shortest_rest_to_rest_s(1.0, velocity, acceleration))
    ramp = min(velocity / acceleration, total / 2)
    top = acceleration * ramp
    covered = top * ramp / 2
    pieces = [
        (ramp, 0.0, 0.0, acceleration),
        (total - ramp, covered, top, 0.0),
        (total, 1 - covered, top, -acceleration),
    ]
    if total - 2 * ramp < 1e-9 * total:  # no cruise
        pieces = [pieces[0], (total, covered, top, -acceleration)]
    ends, starts, speeds, pushes = np.array(pieces).T
    return np.concatenate([[0.0], ends]), starts, speeds, pushes


def _joint_values(name: str, values: ArrayLike, limits: MotionLimits) -> Array:
    return finite(f"the {name} of a move", values, len(limits.velocity))


def _step(start: Array, end: Array) -> Array:
    """Return the signed distance of every joint (joints,); 0 if it is less than rounding."""
    step = end - start
    return np.where(np.abs(step) > NO_WAY, step, 0.0)


def _along(step: Array, limits: MotionLimits) -> tuple[float, float]:
    """Return the limits of the first and second time derivative of the share of a step (joints,) that is done."""
    used = step != 0
    share = np.abs(step[used])
    return float(np.min(limits.velocity[used] / share)), float(np.min(limits.acceleration[used] / share))
