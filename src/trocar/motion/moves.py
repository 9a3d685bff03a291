"""Plain moves from rest to rest: straight in joint space, or straight for the tip."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, MotionLimits, fk, jacobian
from trocar.errors import TrocarError
from trocar.motion.bound import shortest_rest_to_rest_s
from trocar.motion.limits import limit_use, require_range
from trocar.trajectory import Trajectory

HOLD_S = 0.01  # what a move to where the arm already is takes: one control period of the dVRK
KNOTS = 16  # in each phase of a straight move; the tip then stays within 1 um of a line of 40 mm
NEWTON_STEPS = 12
REACHED = 1e-11  # m and rad


def rest_to_rest(q0: ArrayLike, q1: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return the shortest motion along the straight line in joint space: a trapezoid of velocity.

    Args:
        q0: (joints,) start, rad or m.
        q1: (joints,) end.
        limits: bounds of velocity and acceleration.
    """
    start, end = np.asarray(q0, dtype=np.float64), np.asarray(q1, dtype=np.float64)
    joints = np.shape(limits.velocity)
    for name, q in (("start", start), ("end", end)):
        if q.shape != joints or not np.isfinite(q).all():
            raise TrocarError(f"the {name} of a move needs {joints[0]} finite joint values, got {q.tolist()}")
    step = end - start
    if not step.any():
        return Trajectory(np.array([0.0, HOLD_S]), start[None, None])
    used = step != 0
    velocity = np.min(np.asarray(limits.velocity)[used] / np.abs(step[used]))
    acceleration = np.min(np.asarray(limits.acceleration)[used] / np.abs(step[used]))
    times, share, speed, push = _trapezoid(velocity, acceleration)
    coefficients = np.stack([np.outer(push / 2, step), np.outer(speed, step), start + np.outer(share, step)])
    return Trajectory(times, coefficients)


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
    start = np.asarray(q, dtype=np.float64)
    line = np.asarray(displacement_m, dtype=np.float64)
    if start.shape != (len(arm.joints),) or not np.isfinite(start).all():
        raise TrocarError(f"a straight move needs {len(arm.joints)} finite joint values, got {start.tolist()}")
    if line.shape != (3,) or not np.isfinite(line).all():
        raise TrocarError(f"a straight move needs three finite numbers as displacement, got {line.tolist()}")
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
    """Return knots (n + 1,), and pieces' start, speed and acceleration (n,), of the shortest way 0 to 1."""
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
    raise TrocarError(
        f"{arm.name} cannot move its tip straight by {np.round(1e3 * offsets_m[-1], 1).tolist()} mm; "
        f"choose a shorter line or another start"
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
        raise TrocarError(f"{arm.name} is singular on the straight line; choose another start") from None
