"""The value type that all layers share: a path in joint space over time."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry.arrays import finite

MAX_SAMPLES = 10_000_000
"""More than a day at 100 Hz; a request for more must have a step in the wrong unit."""
MAX_STRETCH = 1e9
"""A motion slowed down by more than this would last for years."""

SAME_KNOT_S = 1e-7
"""Knots of two trajectories that are this close become one knot of their sum."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Piecewise polynomial in joint space; ``traj(t_s)`` are positions, ``traj(t_s, 1)`` velocities, and so on.

    Before the first knot the trajectory rests at its start, after the last one at its end.

    Attributes:
        times_s: (n + 1,) increasing knots, the first at 0.
        coefficients: (k, n, joints), highest power first, local to each interval's start (SciPy's ``PPoly``).
    """

    times_s: NDArray[np.float64]
    coefficients: NDArray[np.float64]

    def __post_init__(self) -> None:
        times = finite("the times of a trajectory", self.times_s, "n")
        if len(times) < 2 or not np.all(np.diff(times) > 0):
            raise InvalidInput("a trajectory", f"needs two or more strictly increasing times, got {_few(times)}")
        what = f"the coefficients of a trajectory of {len(times)} times"
        coefficients = finite(what, self.coefficients, "k", len(times) - 1, "joints")
        if not coefficients.size:
            raise InvalidInput(what, f"need at least one power and one joint, got shape {coefficients.shape}")
        from scipy.interpolate import PPoly  # takes half a second, which commands that only print help avoid

        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "coefficients", coefficients)
        object.__setattr__(self, "_poly", PPoly.construct_fast(coefficients, times))

    @staticmethod
    def hermite(times_s: ArrayLike, q: ArrayLike, v: ArrayLike) -> Trajectory:
        """Return the cubic spline through positions ``q`` (n, joints) with velocities ``v`` at ``times_s``."""
        t = finite("the times of a trajectory", times_s, "n")
        q, v = finite("its positions", q, "n", "joints"), finite("its velocities", v, "n", "joints")
        if q.shape != v.shape or q.shape[:1] != t.shape:
            raise InvalidInput(f"times {t.shape}, q {q.shape} and v {v.shape}", "do not fit (n,), (n, joints) twice")
        h = np.diff(t)[:, None]
        dq, v0, v1 = np.diff(q, axis=0), v[:-1], v[1:]
        a = (v1 + v0) / h**2 - 2 * dq / h**3
        b = (v1 - v0) / (2 * h) - 1.5 * a * h
        return Trajectory(t, np.stack([a, b, v0, q[:-1]]))

    def __repr__(self) -> str:
        pieces, joints = self.coefficients.shape[1:]
        return f"<Trajectory of {joints} joints: {self.duration_s:.3f} s in {pieces} pieces>"

    @property
    def duration_s(self) -> float:
        """Return the time from the first knot to the last."""
        return float(self.times_s[-1] - self.times_s[0])

    @property
    def q(self) -> NDArray[np.float64]:
        """Return the positions at the knots (n + 1, joints)."""
        return self(self.times_s)

    def __call__(self, t_s: ArrayLike, order: int = 0) -> NDArray[np.float64]:
        """Return the derivative of this order at the times (...,): (..., joints)."""
        t = np.asarray(t_s, dtype=np.float64)
        inside = np.minimum(np.maximum(t, self.times_s[0]), self.times_s[-1])
        value = self._poly(inside, nu=order)  # type: ignore[attr-defined]
        if order > 0:
            value[(t < self.times_s[0]) | (t > self.times_s[-1])] = 0.0
        return value

    def sample(self, step_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times from the first knot to the last in equal steps of at most ``step_s``, and positions there."""
        if not (step_s > 0 and self.duration_s / step_s < MAX_SAMPLES):
            raise InvalidInput(
                "the sampling step",
                f"is {step_s} s of {self.duration_s:.3f} s",
                f"give one above 0 that makes fewer than {MAX_SAMPLES} samples",
            )
        count = max(1, int(np.ceil(self.duration_s / step_s - 1e-9)))
        times = np.linspace(self.times_s[0], self.times_s[-1], count + 1)
        return times, self(times)

    def stretched(self, factor: float) -> Trajectory:
        """Return the same path taking ``factor`` times as long."""
        if not 0 < factor < MAX_STRETCH:
            raise InvalidInput(
                "a trajectory", f"cannot be stretched by {factor}", f"give a factor above 0 and below {MAX_STRETCH:.0e}"
            )
        if factor == 1.0:
            return self
        powers = np.arange(len(self.coefficients) - 1, -1, -1)[:, None, None]
        start = self.times_s[0]
        return Trajectory(start + factor * (self.times_s - start), self.coefficients / factor**powers)

    def plus(self, other: Trajectory) -> Trajectory:
        """Return the sum of this trajectory and ``other`` over the same time.

        Raises:
            TrocarError: they do not begin and end at the same times.
        """
        if not np.allclose(self.times_s[[0, -1]], other.times_s[[0, -1]], rtol=0.0, atol=SAME_KNOT_S):
            raise InvalidInput(
                f"trajectories over {self.times_s[[0, -1]]} s and {other.times_s[[0, -1]]} s", "do not add"
            )
        nearest = np.abs(other.times_s[:, None] - self.times_s).min(axis=1)
        times = np.sort(np.concatenate([self.times_s, other.times_s[nearest > SAME_KNOT_S]]))
        count = max(len(self.coefficients), len(other.coefficients))
        middle, back = (times[1:] + times[:-1]) / 2, -np.diff(times)[:, None] / 2
        about = [(self(middle, j) + other(middle, j)) / factorial(j) for j in range(count)]  # coefficients there
        terms = [
            sum((comb(j, k) * back ** (j - k) * about[j] for j in range(k, count)), np.zeros_like(about[0]))
            for k in range(count - 1, -1, -1)
        ]
        return Trajectory(times, np.stack(terms))

    def then(self, other: Trajectory) -> Trajectory:
        """Return this trajectory followed by ``other``, whose time is shifted to start at this one's end."""
        k = max(len(self.coefficients), len(other.coefficients))
        parts = [np.pad(c, ((k - len(c), 0), (0, 0), (0, 0))) for c in (self.coefficients, other.coefficients)]
        times = np.concatenate([self.times_s, self.times_s[-1] + other.times_s[1:] - other.times_s[0]])
        return Trajectory(times, np.concatenate(parts, axis=1))


def _few(times: NDArray[np.float64]) -> str:
    """Return some of the times as text, including the first that does not increase."""
    stuck = np.flatnonzero(np.diff(times) <= 0)
    first = int(stuck[0]) if len(stuck) else 0
    more = ", ..." if first + 2 < len(times) else ""
    return f"{'..., ' * (first > 0)}{', '.join(f'{t:g}' for t in times[first : first + 2])}{more} s"
