"""Simple moves: straight in joint space, to rest from a moving start, or straight for the tip."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, MotionLimits, fk, jacobian
from trocar.errors import InvalidInput
from trocar.geometry.arrays import finite
from trocar.motion.bound import shortest_rest_to_rest_s, shortest_to_rest_s
from trocar.motion.limits import KEPT, limit_use, require_range
from trocar.motion.phases import NO_WAY, STILL, joined, phases_to_rest
from trocar.trajectory import Trajectory

HOLD_S = 0.01  # duration of a move to where the arm already is: one control period of the dVRK
KNOTS = 16  # in each phase of a straight move; the tip then stays within 1 um of a line of 40 mm
NEWTON_STEPS = 12
REACHED = 1e-11  # m and rad
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
    times, share, speed, push = _trapezoid(*_along(step, limits))
    coefficients = np.stack([np.outer(push / 2, step), np.outer(speed, step), start + np.outer(share, step)])
    return Trajectory(times, coefficients)


def move_to(q: ArrayLike, velocity: ArrayLike, q_goal: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return a short motion from a moving start to rest at the goal: to replace a running motion.

    From rest, or moving along the straight line in joint space to the goal (or away from it), it keeps to that
    line and takes the least time on it: from rest it is ``rest_to_rest``. Otherwise every joint takes its own path in
    the time that the slowest one needs, which no motion beats, with no more acceleration than that asks for.
    A joint overshoots its goal only if it cannot stop before it.

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
        raise InvalidInput(
            "a move that",
            f"starts with velocities {v.tolist()} breaks the limits {limits.velocity.tolist()}",
            "slow down",
        )
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


def _joint_values(name: str, values: ArrayLike, limits: MotionLimits) -> NDArray[np.float64]:
    """Return one finite number per joint, or raise."""
    return finite(f"the {name} of a move", values, len(limits.velocity))


def _step(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the signed distance of every joint (joints,); 0 if it is less than rounding."""
    step = end - start
    return np.where(np.abs(step) > NO_WAY, step, 0.0)


def _along(step: NDArray[np.float64], limits: MotionLimits) -> tuple[float, float]:
    """Return the greatest rate, and rate of change, of the share of a step (joints,) that is done."""
    used = step != 0
    share = np.abs(step[used])
    return float(np.min(limits.velocity[used] / share)), float(np.min(limits.acceleration[used] / share))


def straight(arm: ArmModel, q: ArrayLike, displacement_m: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return the motion that takes the tip along a straight line without turning it, from rest to rest.

    For the last millimetres over a peg, where a spline's bulge would touch.

    Args:
        arm: the arm that moves.
        q: (joints,) where it starts, rad or m.
        displacement_m: (3,) of the tip, in the arm's base frame.
        limits: bounds of velocity and acceleration.

    Raises:
        TrocarError: the line leaves the arm's reach or a joint's range, or is not three finite numbers.
    """
    start = finite("the start of a straight move", q, len(arm.joints))
    line = finite("the displacement of a straight move", displacement_m, 3)
    if not line.any():
        return Trajectory(np.array([0.0, HOLD_S]), start[None, None])
    dense = _along_line(arm, start, np.linspace(0, 1, KNOTS)[:, None] * line)
    slope = np.abs(np.gradient(dense, 1 / (KNOTS - 1), axis=0)).max(axis=0) + 1e-12
    velocity, acceleration = np.min(limits.velocity / slope), np.min(limits.acceleration / slope)
    corners, share, speed, push = _trapezoid(velocity, acceleration)
    parts = [np.linspace(a, b, KNOTS, endpoint=False) for a, b in pairwise(corners)]
    times = np.append(np.concatenate(parts), corners[-1])
    piece = np.clip(np.searchsorted(corners, times, side="right") - 1, 0, len(push) - 1)
    since = times - corners[piece]
    along = share[piece] + speed[piece] * since + push[piece] * since**2 / 2
    rate = speed[piece] + push[piece] * since
    path = _along_line(arm, start, along[:, None] * line)
    tangent = _joint_velocity(arm, path, line)
    use = limit_use(arm, Trajectory.hermite(times, path, rate[:, None] * tangent), limits)
    stretch = max(use.velocity_ratio, np.sqrt(use.acceleration_ratio))
    trajectory = Trajectory.hermite(stretch * times, path, rate[:, None] / stretch * tangent)
    require_range(arm, trajectory)
    return trajectory


def _trapezoid(
    velocity: float, acceleration: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return knots (n + 1,), and pieces' start, speed and acceleration (n,), of the shortest move from 0 to 1."""
    total = float(shortest_rest_to_rest_s(1.0, velocity, acceleration))
    ramp = min(velocity / acceleration, total / 2)
    top = acceleration * ramp
    covered = top * ramp / 2
    if total - 2 * ramp < 1e-9 * total:
        return (
            np.array([0.0, ramp, total]),
            np.array([0.0, covered]),
            np.array([0.0, top]),
            np.array([acceleration, -acceleration]),
        )
    return (
        np.array([0.0, ramp, total - ramp, total]),
        np.array([0.0, covered, 1 - covered]),
        np.array([0.0, top, top]),
        np.array([acceleration, 0.0, -acceleration]),
    )


def _along_line(arm: ArmModel, start: NDArray[np.float64], offsets_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joint values (n, joints) that move the tip by ``offsets_m`` (n, 3) and keep its rotation.

    Newton's method from the start's tangent, so the arm never changes its branch.
    """
    home = fk(arm, start)
    R_tip_base = home.rotation.inverse()
    q = start + _joint_velocity(arm, np.broadcast_to(start, (len(offsets_m), len(start))), offsets_m)
    for _ in range(NEWTON_STEPS):
        T = fk(arm, q)
        missing_m = home.translation_m + offsets_m - T.translation_m
        turned_rad = (T.rotation @ R_tip_base).log()
        if max(np.abs(missing_m).max(), np.abs(turned_rad).max()) < REACHED:
            return q
        q = q + _solve(arm, q, np.concatenate([missing_m, -turned_rad], axis=1))
    raise InvalidInput(
        arm.name,
        f"cannot move its tip straight by {np.round(1000.0 * offsets_m[-1], 1).tolist()} mm",
        "choose a shorter line or another start",
    )


def _joint_velocity(arm: ArmModel, q: NDArray[np.float64], velocity_m_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joint velocities (n, joints) that move the tip at these velocities without turning it."""
    linear = np.broadcast_to(velocity_m_s, (len(q), 3))
    return _solve(arm, q, np.concatenate([linear, np.zeros_like(linear)], axis=1))


def _solve(arm: ArmModel, q: NDArray[np.float64], twists: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joint velocities (n, joints) of the tip's twists (n, 6) in the base frame."""
    try:
        return np.linalg.solve(jacobian(arm, q), twists[..., None])[..., 0].astype(np.float64)
    except np.linalg.LinAlgError:
        raise InvalidInput(arm.name, "is singular on the straight line", "choose another start") from None
