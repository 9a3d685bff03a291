"""Quadratic programs over paths that keep a robot's limits of velocity and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from trocar.arms import MotionLimits
from trocar.errors import NoPlan
from trocar.geometry.arrays import Array
from trocar.motion.qp import Program
from trocar.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class QuadraticSpline:
    """All paths through n intervals with constant acceleration in each, continuous in position and velocity.

    A path is given by n + 2 control points (rad or m). The path in interval k depends only on the three points k, k + 1
    and k + 2; weights (..., 3) of these give a position, a velocity or an acceleration. Bounds on velocities at the
    knots and on accelerations hold for the whole path, because velocity is linear in between; and the path stays
    between the least and the greatest of its control points.
    """

    times_s: Array  # (n + 1,) increasing knots, n of 2 or more

    @cached_property
    def steps_s(self) -> Array:
        """Return the lengths (n,) of the intervals."""
        return np.diff(self.times_s)

    @cached_property
    def intervals(self) -> NDArray[np.int64]:
        """Return the interval (n + 1,) to which each knot belongs: the one after it, or before it for the last knot."""
        count = len(self.steps_s)
        return np.minimum(np.arange(count + 1), count - 1)

    @cached_property
    def position(self) -> Array:
        """Return the weights (n + 1, 3) of the positions at the knots."""
        h = self.steps_s
        after = np.concatenate([[1.0], h[1:] / (h[:-1] + h[1:])])
        return np.vstack([np.column_stack([after, 1.0 - after, np.zeros_like(h)]), [0.0, 0.0, 1.0]])

    @cached_property
    def velocity(self) -> Array:
        """Return the weights (n + 1, 3) of the velocities at the knots, per s."""
        middles = np.concatenate([self.times_s[:1], (self.times_s[:-1] + self.times_s[1:]) / 2, self.times_s[-1:]])
        rate = 1.0 / np.diff(middles)
        at_starts = np.column_stack([-rate[:-1], rate[:-1], np.zeros_like(rate[1:])])
        return np.vstack([at_starts, [0.0, -rate[-1], rate[-1]]])

    @cached_property
    def acceleration(self) -> Array:
        """Return the weights (n, 3) of the accelerations in the intervals, per s^2."""
        start, end = self.velocity[:-1], np.roll(self.velocity[1:], 1, axis=1)
        end[-1] = self.velocity[-1]
        return (end - start) / self.steps_s[:, None]

    def position_after(self, since_s: Array) -> Array:
        """Return the weights (n, 3) of the position at these times (n,) after each interval's start."""
        t = since_s[:, None]
        return self.position[:-1] + t * self.velocity[:-1] + t * t / 2 * self.acceleration

    def reach(self, speed: Array, limits: MotionLimits) -> Array:
        """Return the greatest distance (joints,) that such paths cover from these speeds (joints,) to rest.

        The longest path accelerates as long as it can, in the first intervals, and brakes afterwards, with a stretch at
        full speed in between if needed. (Full speed may be reached within an interval, which cannot be represented
        exactly; this is neglected.)

        Args:
            speed: (joints,) at the start; low enough to stop within the path's time.
            limits: velocity and acceleration limits.
        """
        since, push = (self.times_s - self.times_s[0])[:, None], limits.acceleration
        forward_s = (since[-1] - speed / push) / 2
        share = np.clip((forward_s - since[:-1]) / self.steps_s[:, None], 0.0, 1.0)
        impulse = (2.0 * share - 1.0) * push * self.steps_s[:, None]
        way = speed * since[-1] + np.sum(impulse * (since[-1] - (since[:-1] + since[1:]) / 2), axis=0)
        top = limits.velocity
        ramps = ((top - speed) ** 2 + top**2) / (2 * push)
        return np.where(speed + push * forward_s > top, np.minimum(way, top * since[-1] - ramps), way)

    @staticmethod
    def at(weights: Array, intervals: NDArray[np.int64], points: Array) -> Array:
        """Return weighted sums (k, joints) of control points (n + 2, joints); weights (k, 3) in intervals (k,)."""
        return sum(weights[:, i, None] * points[intervals + i] for i in range(3))  # type: ignore[return-value]

    def trajectory(self, points: Array) -> Trajectory:
        """Return the path of control points (n + 2, joints)."""
        within = self.intervals[:-1]
        q, v = (self.at(weights[:-1], within, points) for weights in (self.position, self.velocity))
        return Trajectory(self.times_s, np.stack([self.at(self.acceleration, within, points) / 2, v, q]))


HEADROOM = 1e-7  # share of the limits that stays unused, to allow for rounding by the solver and the checks
PRECISION = 1e-8  # precision of the solver, as a share of the limits
ROOM = 5e-8  # commands stay this far (rad, m) inside their ranges, for the same reason


@dataclass(frozen=True, eq=False)
class LimitedPaths:
    """All paths of six joints over a spline's knots that start as given, keep the limits, and end at rest.

    A path is defined by its free control points x (m, 6): all but the first two, which the start fixes, and the last,
    which is the same as the one before it because the path ends at rest.
    """

    spline: QuadraticSpline  # over n intervals; m = n - 1
    q_start: Array  # (6,) where the path starts, rad and m
    velocity_start: Array  # (6,) and how fast, per s
    limits: MotionLimits
    lower: Array  # (6,) least position
    upper: Array  # (6,) greatest position
    weights_s: Array  # (n + 1,) weight of an error at each knot, about the time that the knot represents

    def points(self, x: Array) -> Array:
        """Return all control points (n + 2, 6)."""
        return np.concatenate([self._start[:2], x, x[-1:]])

    def columns(self, weights: Array, intervals: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
        """Return weights (..., 3) of control points as weights (..., 3) of free ones, and the indices of these."""
        columns = intervals[..., None] + np.arange(-2, 1)
        return np.where(columns >= 0, weights, 0.0), np.clip(columns, 0, len(self.spline.steps_s) - 2)

    def pull(self, errors: Array) -> Array:
        """Return the gradient (m, 6) of half the weighted squares of errors (n + 1, 6) at the knots."""
        return self._position.T @ (self.weights_s[:, None] * errors)

    def hessian(self, nearness: Array, smoothness: Array) -> sparse.csc_matrix:
        """Return the Hessian (6 m, 6 m), joint by joint, of weighted (6,) squares of positions and of accelerations."""
        free = len(self.spline.steps_s) - 1
        shift = free * np.arange(6)[:, None]
        parts = [(nearness, self._near), (smoothness, self._smooth)]
        data = np.concatenate([(scale[:, None] * part.data).ravel() for scale, part in parts])
        rows = np.concatenate([(shift + part.row).ravel() for _, part in parts])
        columns = np.concatenate([(shift + part.col).ravel() for _, part in parts])
        return sparse.csc_matrix((data, (rows, columns)), shape=(6 * free, 6 * free))

    @cached_property
    def push(self) -> Array:
        """Return the gradient (m, 6) of half the squares of the accelerations at x = 0."""
        return self._acceleration.T @ (self.spline.steps_s[:, None] * self._at_start(self.spline.acceleration))

    @cached_property
    def resting(self) -> Array:
        """Return the positions (n + 1, 6) at the knots at x = 0."""
        return self._at_start(self.spline.position)

    def solve(self, hessian: sparse.csc_matrix, gradient: Array) -> Array | None:
        """Return the free control points (m, 6) that minimise ``x H x / 2 + g x``; None if no path is allowed."""
        size = float(hessian.diagonal().mean())
        scaled, linear = hessian / size, gradient.T.ravel() / size
        lower, upper = self.lower + ROOM, self.upper - ROOM
        # The ranges are so rarely active that it is faster to try without them first.
        for box in ((None, None), tuple(np.repeat(bound, len(gradient)) for bound in (lower, upper))):
            program = Program("commands", scaled, linear, *box, precision=PRECISION, relative=PRECISION / 10)
            program.keep("velocity and acceleration", *self._bounds)
            try:
                x = program.least().reshape(6, -1).T.copy()
            except NoPlan:
                return None
            if np.all((x >= lower) & (x <= upper)):
                break
        return x

    @cached_property
    def _start(self) -> Array:
        """Return the control points (n + 2, 6) at x = 0."""
        points = np.zeros((len(self.spline.steps_s) + 2, 6))
        points[0] = self.q_start
        points[1] = self.q_start + self.velocity_start * self.spline.steps_s[0] / 2
        return points

    def _at_start(self, weights: Array) -> Array:
        return self.spline.at(weights, self.spline.intervals[: len(weights)], self._start)

    @cached_property
    def _position(self) -> sparse.csr_matrix:
        return self._matrix(self.spline.position)

    @cached_property
    def _acceleration(self) -> sparse.csr_matrix:
        return self._matrix(self.spline.acceleration)

    @cached_property
    def _near(self) -> sparse.coo_matrix:
        return (self._position.T @ self._position.multiply(self.weights_s[:, None])).tocoo()

    @cached_property
    def _smooth(self) -> sparse.coo_matrix:
        return (self._acceleration.T @ self._acceleration.multiply(self.spline.steps_s[:, None])).tocoo()

    @cached_property
    def _bounds(self) -> tuple[sparse.csr_matrix, Array, Array]:
        """Return constraint rows with their bounds: accelerations, and velocities that could exceed their limits."""
        speeds, pushes = ((1 - HEADROOM) * limit for limit in (self.limits.velocity, self.limits.acceleration))
        duration = self.spline.times_s[-1] - self.spline.times_s[0]
        fast = np.flatnonzero((np.abs(self.velocity_start) + pushes * duration) / 2 > speeds)
        parts = [(joint, self.spline.acceleration, pushes[joint]) for joint in range(6)]
        parts += [(joint, self.spline.velocity[1:-1], speeds[joint]) for joint in fast.tolist()]
        free, blocks, zeros = len(self.spline.steps_s) - 1, [], []
        for joint, weights, limit in parts:
            first = len(self.spline.times_s) - 1 - len(weights)
            intervals = self.spline.intervals[first : first + len(weights)]
            blocks.append(self._matrix(weights / limit, intervals, 6 * free, joint * free))
            zeros.append(self.spline.at(weights / limit, intervals, self._start[:, joint, None])[:, 0])
        zero = np.concatenate(zeros)
        return sparse.csr_matrix(sparse.vstack(blocks)), -1.0 - zero, 1.0 - zero

    def _matrix(
        self, weights: Array, intervals: NDArray[np.int64] | None = None, width: int = 0, shift: int = 0
    ) -> sparse.csr_matrix:
        """Return the matrix of weights (k, 3) in intervals (k,); by default, in all intervals of the spline."""
        intervals = self.spline.intervals[: len(weights)] if intervals is None else intervals
        data, columns = self.columns(weights, intervals)
        matrix = sparse.csr_matrix(
            (data.ravel(), (shift + columns).ravel(), np.arange(0, data.size + 1, 3)),
            shape=(len(data), width or len(self.spline.steps_s) - 1),
        )
        matrix.sum_duplicates()
        return matrix
