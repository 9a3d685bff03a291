"""How much of its limits a trajectory uses, also between the knots, where splines overshoot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import comb, perm

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.checks import small
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory

CHECK_STEP_S = 1e-3  # ten times finer than the control period of the dVRK, 10 ms
KEPT = 1 + 1e-9  # a ratio up to this counts as kept: planners use the full limit, and floats round
JUMP = 1e-6  # share of the acceleration limit by which an acceleration may differ on the two sides of a knot


@dataclass(frozen=True, eq=False)
class LimitUse:
    """The largest share of each limit that a trajectory uses, by joint; 1 is the limit.

    Attributes:
        velocity: (joints,) over all times.
        acceleration: (joints,) over all times, on both sides of every knot.
        jerk: (joints,) the same; infinite where the acceleration jumps, 0 where no jerk is limited.
        range_excess: (joints,) how far each joint leaves its range, rad or m; 0 inside.
    """

    velocity: Array
    acceleration: Array
    jerk: Array
    range_excess: Array

    @property
    def velocity_ratio(self) -> float:
        """Return the largest share of a velocity limit."""
        return float(self.velocity.max())

    @property
    def acceleration_ratio(self) -> float:
        """Return the largest share of an acceleration limit."""
        return float(self.acceleration.max())

    @property
    def jerk_ratio(self) -> float:
        """Return the largest share of a jerk limit."""
        return float(self.jerk.max())

    @property
    def kept(self) -> bool:
        """Return whether every limit is kept."""
        ratios = (self.velocity_ratio, self.acceleration_ratio, self.jerk_ratio)
        return max(ratios) <= KEPT and not self.range_excess.any()


def limit_use(arm: ArmModel, trajectory: Trajectory, limits: MotionLimits) -> LimitUse:
    """Return how much of the arm's limits the trajectory uses, at 1 kHz and on both sides of every knot.

    >>> use = limit_use(arm, trajectory, limits)
    >>> use.kept, round(use.acceleration_ratio, 2)
    (True, 1.0)

    Args:
        arm: gives the joints' ranges.
        trajectory: of the arm's joints.
        limits: bounds of velocity and acceleration, and optionally of jerk.
    """
    times, joints = trajectory.times_s, trajectory.coefficients.shape[2]
    if not joints == len(arm.joints) == len(limits.velocity):
        problem = f"has {len(arm.joints)} joints, its trajectory {joints} and the limits {len(limits.velocity)}"
        raise InvalidInput(arm.name, problem, "give what belongs together")
    pieces = np.arange(len(times) - 1)
    orders = (0, 1, 2) if limits.jerk is None else (0, 1, 2, 3)
    # every sample is assigned to a piece; a knot belongs to the piece before it and to the one after it
    piece = np.concatenate([pieces, pieces])
    since = np.concatenate([np.zeros(len(pieces)), times[1:] - times[:-1]])
    at_knots = _derivatives(trajectory, piece, since, orders)
    grid = np.arange(times[0], times[-1], CHECK_STEP_S)
    found = np.minimum(np.searchsorted(times, grid, side="right") - 1, pieces[-1])  # arange may reach the end
    # samples are needed only on pieces whose extremes may lie between the knots
    inside = np.logical_or.reduce([_beyond(trajectory, k, at) for k, at in zip(orders, at_knots, strict=True)])[found]
    between = _derivatives(trajectory, found[inside], (grid - times[found])[inside], orders)
    q, v, a, *jerks = (np.concatenate(both, axis=1) for both in zip(between, at_knots, strict=True))
    jerk = np.zeros(len(arm.joints))
    if limits.jerk is not None:
        jerk = np.abs(jerks[0]).max(axis=1) / limits.jerk
        jerk[_acceleration_jumps(trajectory, limits)] = np.inf
    speed, push = np.abs(v).max(axis=1) / limits.velocity, np.abs(a).max(axis=1) / limits.acceleration
    beyond = np.maximum(0.0, np.maximum(arm.lower - q.min(axis=1), q.max(axis=1) - arm.upper))
    return LimitUse(speed, push, jerk, beyond)


def require_range(arm: ArmModel, use: LimitUse) -> None:
    """Raise OutOfReach if a joint leaves its range anywhere on the trajectory that ``use`` describes."""
    for joint, excess in zip(arm.joints, use.range_excess, strict=True):
        if excess > 0.0:
            sentence = (
                f"the planned motion takes joint '{joint.name}' {small(excess)} {joint.unit} out of its range "
                f"[{joint.lower:.4f}, {joint.upper:.4f}] between the waypoints; move the waypoints inwards"
            )
            raise OutOfReach(sentence, arm=arm.name, joint=joint.name, by=float(excess))


def knot_jumps(trajectory: Trajectory, order: int) -> Array:
    """Return by how much the derivative of this order differs before and after each inner knot: (joints, knots)."""
    times, after = trajectory.times_s, np.arange(1, len(trajectory.times_s) - 1)
    (left,) = _derivatives(trajectory, after - 1, times[after] - times[after - 1], (order,))
    (right,) = _derivatives(trajectory, after, np.zeros(len(after)), (order,))
    return np.abs(left - right)


def hulls(trajectory: Trajectory, order: int) -> Array:
    """Return values (k, pieces, joints) whose least and greatest bound the derivative on each piece, ends included.

    They are its Bernstein coefficients: a polynomial lies in their hull.
    """
    degree = max(0, len(trajectory.coefficients) - 1 - order)
    h = np.diff(trajectory.times_s)[:, None]
    rows = trajectory.coefficients[::-1][order : order + degree + 1]
    if not len(rows):
        return np.zeros((1, *trajectory.coefficients.shape[1:]))
    powers = np.stack([perm(k + order, order) * row * h**k for k, row in enumerate(rows)])
    return np.tensordot(_weights(degree), powers, axes=1)


@cache
def _weights(degree: int) -> Array:
    """Return the Bernstein coefficients (degree + 1, degree + 1) of the powers up to this one, in columns."""
    return np.array([[comb(i, k) / comb(degree, k) for k in range(degree + 1)] for i in range(degree + 1)])


def _beyond(trajectory: Trajectory, order: int, at_knots: Array) -> NDArray[np.bool_]:
    """Return the pieces (pieces,) on which a derivative may exceed its values (joints, n) at the knots."""
    hull = hulls(trajectory, order)
    low, high = at_knots.min(axis=1), at_knots.max(axis=1)
    if order:
        high = np.maximum(-low, high)
        low = -high
    return np.any((hull.min(axis=0) < low) | (hull.max(axis=0) > high), axis=1)


def _acceleration_jumps(trajectory: Trajectory, limits: MotionLimits) -> NDArray[np.bool_]:
    """Return which joints' acceleration jumps: at a knot, into the rest at the end, out of a rest at the start."""
    times = trajectory.times_s
    (ends,) = _derivatives(trajectory, np.array([0, len(times) - 2]), np.array([0.0, times[-1] - times[-2]]), (2,))
    ends[:, 0] *= trajectory(times[0], 1) == 0  # the acceleration of a motion already running is not known here
    jumps = np.concatenate([knot_jumps(trajectory, 2), np.abs(ends)], axis=1)
    return np.any(jumps > JUMP * limits.acceleration[:, None], axis=1)


def _derivatives(trajectory: Trajectory, piece: NDArray[np.intp], since_s: Array, orders: Sequence[int]) -> list[Array]:
    """Return derivatives ``since_s`` after the start of these pieces, seen from within them: (joints, n) each."""
    degree = len(trajectory.coefficients) - 1
    # joints before samples: whole rows are then multiplied by the times, which halves the time of a check
    coefficients = trajectory.coefficients.transpose(0, 2, 1).copy()[:, :, piece]
    values = []
    for order in orders:
        value = np.zeros(coefficients.shape[1:])
        for k in range(degree - order + 1):  # Horner's rule; perm is the factor that differentiating a power leaves
            value *= since_s
            value += perm(degree - k, order) * coefficients[k]
        values.append(value)
    return values
