"""Shortest cubic between two moving ends, a step that every spline planner takes thousands of times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits


@dataclass(frozen=True, eq=False)
class CubicGrid:
    """The durations ``first_s + k step_s`` on which cubics through fixed positions are tried.

    With ``s = 1 / t`` the accelerations of a cubic at its two ends are ``6 dq s^2 - (4 v0 + 2 v1) s`` and
    ``-6 dq s^2 + (2 v0 + 4 v1) s``. Multiplied by ``t``, the limit ``A`` reads ``6 dq s - A t <= c <= 6 dq
    s + A t`` with ``c = 4 v0 + 2 v1`` or ``2 v0 + 4 v1``: both bounds are known before the velocities are, so planning
    only has to compare.

    Attributes:
        times_s: (grid,) durations, ascending; the last is infinite and stands for "none on the grid".
        step_q: (segments, joints) positions' differences, rad or m.
        limits: bounds of velocity and acceleration.
        lower: (joints, batch, 2 segments, grid) least ``c`` that keeps the acceleration's limit, starts
            then ends; repeated over the batch, because NumPy compares equal shapes twice as fast as
            broadcast ones.
        upper: the greatest.
        sums: (3 segments, waypoints) takes velocities to ``4 v0 + 2 v1``, ``2 v0 + 4 v1`` and ``v0 + v1``.
    """

    times_s: NDArray[np.float64]
    step_q: NDArray[np.float64]
    limits: MotionLimits
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    sums: NDArray[np.float64]

    @classmethod
    def build(
        cls,
        waypoints: NDArray[np.float64],
        limits: MotionLimits,
        *,
        first_s: float,
        step_s: float,
        longest_s: float,
        batch: int,
    ) -> CubicGrid:
        """Return the grid up to about ``longest_s`` for the segments between waypoints (n, joints)."""
        count = max(1, int(np.ceil((longest_s - first_s) / step_s)) + 1)
        times = np.append(first_s + step_s * np.arange(count), np.inf)
        step_q = np.diff(waypoints, axis=0)
        centre = np.ascontiguousarray(np.tile(6 * step_q, (batch, 2, 1)).transpose(2, 0, 1))[..., None] / times
        reach = limits.acceleration[:, None, None, None] * times
        start, end = np.eye(len(waypoints))[:-1], np.eye(len(waypoints))[1:]
        sums = np.concatenate([4 * start + 2 * end, 2 * start + 4 * end, start + end])
        return cls(times, step_q, limits, centre - reach, centre + reach, sums)

    def shortest(self, velocities: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the first duration on the grid that keeps the limits.

        Args:
            velocities: (batch, segments + 1, joints) at the waypoints, rad/s or m/s.

        Returns:
            (batch, segments) s; infinite where no duration on the grid will do.
        """
        segments = len(self.step_q)
        sums = self.sums @ velocities
        c = sums[:, : 2 * segments].transpose(2, 0, 1)[..., None]
        kept = np.logical_and.reduce((self.lower <= c) & (c <= self.upper), axis=0)
        allowed = kept[:, :segments] & kept[:, segments:]
        pull = 3 * self.step_q
        while True:
            first = allowed.argmax(axis=-1)
            times = self.times_s[first]
            middle = pull / times[..., None] - sums[:, 2 * segments :]
            if self._clearly_slow(velocities, middle):
                return times
            fast = self._too_fast(velocities, middle) & (times < np.inf)
            if not fast.any():
                return times
            allowed[fast, first[fast]] = False

    def _clearly_slow(self, velocities: NDArray[np.float64], middle: NDArray[np.float64]) -> bool:
        """Return whether the hulls alone show that all cubics keep the velocity limit, as is mostly the case."""
        hull = np.abs(np.concatenate([velocities, middle], axis=1))
        return bool((hull <= self.limits.velocity).all())

    def _too_fast(self, velocities: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether cubics (batch, segments) violate the velocity limit.

        A cubic's velocity is the quadratic with Bernstein coefficients ``v0, middle, v1``, so it lies in
        their hull.
        """
        limit = self.limits.velocity
        ends = np.abs(velocities) <= limit
        inner = np.abs(middle) <= limit
        v0, v1 = velocities[:, :-1], velocities[:, 1:]
        return ~np.all(ends[:, :-1] & ends[:, 1:] & (inner | (np.abs(_peak(v0, middle, v1)) <= limit)), axis=-1)


def _peak(v0: NDArray[np.float64], middle: NDArray[np.float64], v1: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the velocity at the cubic's inner extremum, or at its start if it has none.

    That is where the second derivative ``6 a t + 2 b`` is zero (the paper's section IV-C prints 6a + 2b).
    """
    bend = v0 - 2 * middle + v1
    rise = v0 - middle
    share = np.divide(rise, bend, out=np.full_like(bend, -1.0), where=bend != 0)
    return np.where((share > 0) & (share < 1), v0 - share * rise, v0)
