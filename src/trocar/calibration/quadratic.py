"""Paths of piecewise constant acceleration as quadratic B-splines, on which limits are linear constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class QuadraticSpline:
    """All paths through n intervals with constant acceleration in each, continuous in position and velocity.

    A path is given by n + 2 control points (rad or m). The path in interval k depends only on the three points k, k + 1
    and k + 2; weights (..., 3) of these give a position, a velocity or an acceleration. Bounds on velocities at the
    knots and on accelerations hold for the whole path, because velocity is linear in between; and the path stays
    between the least and the greatest of its control points.

    Attributes:
        times_s: (n + 1,) increasing knots, n of 2 or more.
    """

    times_s: Array

    @cached_property
    def steps_s(self) -> Array:
        """Return the lengths (n,) of the intervals."""
        return np.diff(self.times_s)

    @cached_property
    def intervals(self) -> NDArray[np.int64]:
        """Return the interval (n + 1,) to which each knot belongs: the next one; for the last knot, the one before."""
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
            speed: at the start; low enough to stop within the path's time.
            limits: of velocity and acceleration.
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
