"""One measured signal as positions, velocities and accelerations: a quadratic program with Huber losses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import piqp
from numpy.typing import NDArray
from scipy import sparse

from trocar.errors import InvalidInput

Array = NDArray[np.float64]

THRESHOLD = 1.345
"""Where the Huber losses become linear, in standard deviations: within 5 % of least squares on Gaussian noise."""
WINDOW, OVERLAP = 2000, 100
"""Number of samples solved at once, and how many two windows share; each window supplies half of the shared ones."""
CHOSEN_ON = 800
"""Number of samples used in cross-validation, where the signal moves most."""
DECADES, FIRST_DECADE = (-3, 7), 1
"""Steps between the smoothness weights of cross-validation: a descent by decades, then by half decades."""
HELD_OUT = 7
"""One in this many samples is held out, to be predicted."""
PRECISION = 1e-6
"""Precision of the solver, in standard deviations of the noise."""
FINEST = 1e-7
"""The noise is assumed to be at least this share of the signal's range: single precision."""
SHORTEST = 16
"""Minimum number of samples of a signal."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A signal and its derivatives at the times of the samples.

    Attributes:
        position: (n,) in the signal's unit.
        velocity: (n,) per second.
        acceleration: (n,) per second squared.
    """

    position: Array
    velocity: Array
    acceleration: Array


def estimate(measured: Array, step_s: float, smoothness: float | None = None) -> Motion:
    """Return the motion behind a measured signal.

    After Hwang et al. 2022, section IV-E, which follows Todorov and Jordan (1998). Their program as printed leaves
    the velocity at the start free and can meet every noisy sample exactly; this one is amended in two places (docs,
    "Trajectory analysis"). It minimises, over positions p, velocities v and accelerations a::

        sum huber((q_t - p_t) / s) + sum huber(sqrt(w) (a_t+1 - a_t) T^2 / s)
        p_t+1 = p_t + v_t T + (2 a_t + a_t+1) T^2 / 6
        v_t+1 = v_t + (a_t + a_t+1) T / 2

    So measurements that lie far off count linearly, and so do jumps of the acceleration, which time-optimal motions
    have. The noise s is estimated from sixth differences; the weight w is the one that predicts held-out samples best.

    Args:
        measured: (n,) at even steps; NaN where there is no measurement.
        step_s: between samples.
        smoothness: w; None: by cross-validation.
    """
    there = np.isfinite(measured)
    if measured.ndim != 1 or len(measured) < SHORTEST or np.count_nonzero(there) < len(measured) / 2:
        raise InvalidInput(
            "a signal",
            f"needs {SHORTEST} or more samples (n,), half of them measured",
            f"got shape {measured.shape}, {np.count_nonzero(there)} measured",
        )
    if not step_s > 0:
        raise InvalidInput("the time between samples", f"is {step_s} s", "give a time above 0")
    times = np.arange(len(measured))
    bridged = np.interp(times, times[there], measured[there])
    reach, middle = float(np.ptp(bridged)), float(np.median(bridged))
    if reach == 0.0:
        zeros = np.zeros(len(measured))
        return Motion(bridged, zeros, zeros.copy())
    noise = max(noise_sd(bridged), FINEST * reach)
    scaled, kept = (bridged - middle) / noise, there.astype(np.float64)
    if smoothness is None:
        where = _liveliest(scaled)
        smoothness = _best_weight(scaled[where], kept[where])
    p, v, a = _in_windows(scaled, smoothness, kept)
    return Motion(middle + noise * p, noise * v / step_s, noise * a / step_s**2)


def noise_sd(measured: Array) -> float:
    """Return the standard deviation of white noise on a smooth signal, without outliers, from sixth differences."""
    gain = np.sqrt(924.0)  # root of the sum of the squared binomials (6 over k)
    return float(1.4826 * np.median(np.abs(np.diff(measured, 6))) / gain)


def _liveliest(scaled: Array) -> slice:
    """Return the stretch of at most CHOSEN_ON samples in which the signal moves most."""
    if len(scaled) <= CHOSEN_ON:
        return slice(0, len(scaled))
    steps = np.abs(np.diff(scaled))
    moved = np.concatenate([[0.0], np.cumsum(np.minimum(steps, np.quantile(steps, 0.98)))])  # outliers do not affect it
    first = int(np.argmax(moved[CHOSEN_ON - 1 :] - moved[: len(moved) - CHOSEN_ON + 1]))
    return slice(first, first + CHOSEN_ON)


def _best_weight(scaled: Array, kept: Array) -> float:
    """Return the smoothness weight with which held-out samples are predicted best (mean Huber loss)."""
    held_out = np.zeros(len(scaled), dtype=bool)
    held_out[HELD_OUT // 2 :: HELD_OUT] = True
    judged = held_out & (kept > 0)

    @cache
    def error(power: float) -> float:
        position = _solve(scaled, 10.0**power, np.where(held_out, 0.0, kept))[0]
        return float(_huber(scaled[judged] - position[judged]).mean())

    best = FIRST_DECADE
    while (better := min((p for p in (best - 1, best, best + 1) if DECADES[0] <= p <= DECADES[1]), key=error)) != best:
        best = better
    return 10.0 ** min((best - 0.5, best, best + 0.5), key=error)


def _huber(error: Array) -> Array:
    size = np.abs(error)
    return np.where(size <= THRESHOLD, 0.5 * error**2, THRESHOLD * (size - 0.5 * THRESHOLD))


def _in_windows(scaled: Array, weight: float, kept: Array) -> tuple[Array, ...]:
    """Return position, velocity and acceleration, solved window by window."""
    n = len(scaled)
    found = tuple(np.empty(n) for _ in range(3))
    first = 0
    while True:
        last = min(first + WINDOW, n)
        if n - last < WINDOW // 4:  # a longer last window is better than a very short one
            last = n
        part = _solve(scaled[first:last], weight, kept[first:last])
        skip = 0 if first == 0 else OVERLAP // 2
        for whole, piece in zip(found, part, strict=True):
            whole[first + skip : last] = piece[skip:]
        if last == n:
            return found
        first = last - OVERLAP


def _solve(scaled: Array, weight: float, kept: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity times T and acceleration times T squared of one window, in units of the noise.

    Args:
        scaled: (n,) measurements.
        weight: of smoothness.
        kept: (n,) 1 where a measurement counts, 0 where not.
    """
    n = len(scaled)
    residuals, dynamics = _losses(kept, np.sqrt(weight)), _dynamics(n)
    cost = -(residuals.T @ np.concatenate([kept * scaled, np.zeros(n - 1)]))
    cost[3 * n :] += THRESHOLD
    lower = np.full(len(cost), -np.inf)
    lower[3 * n :] = 0.0
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = PRECISION
    quadratic = (residuals.T @ residuals).tocsc()
    solver.setup(quadratic, cost, dynamics, np.zeros(2 * (n - 1)), None, None, None, lower, None)
    if solver.solve() != piqp.PIQP_SOLVED:
        raise InvalidInput(
            "no motion",
            f"could be fitted to {n} samples (solver: {solver.result.info.status})",
            "give positions at even steps",
        )
    p, v, a = solver.result.x[: 3 * n].reshape(3, n)
    return p.copy(), v.copy(), a.copy()


def _losses(kept: Array, root: float) -> sparse.csc_matrix:
    """Return the matrix of the squared terms: measurements that are kept, then jumps of the acceleration.

    The variables are p, v, a (n each), then the linear parts of the Huber losses: above and below each measurement
    (n each), above and below each jump (n - 1 each).
    """
    n = len(kept)
    measured, jump, free = _bands(n, [kept]), _bands(n - 1, [np.ones(n - 1)]), _bands(n, [np.zeros(n)])
    rows = [
        [measured, free, free, measured, -measured, None, None],
        [None, None, root * _change(n), None, None, -jump, jump],
    ]
    return sparse.csc_matrix(sparse.bmat(rows))


def _dynamics(n: int) -> sparse.csc_matrix:
    """Return the matrix of the equations between samples, with T and T squared absorbed into v and a."""
    change, here = _change(n), _two(n, 1.0, 0.0)
    free = sparse.csc_matrix((n - 1, 4 * n - 2))
    rows = [[change, -here, -_two(n, 1 / 3, 1 / 6), free], [None, change, -_two(n, 1 / 2, 1 / 2), None]]
    return sparse.csc_matrix(sparse.bmat(rows))


def _change(n: int) -> sparse.csc_matrix:
    """Return the matrix of differences of neighbours (n - 1, n)."""
    return _two(n, -1.0, 1.0)


def _two(n: int, this: float, following: float) -> sparse.csc_matrix:
    """Return the matrix (n - 1, n) that weights each sample and the next one."""
    return _bands(n, [np.full(n - 1, this), np.full(n - 1, following)])


def _bands(n: int, bands: list[Array]) -> sparse.csc_matrix:
    """Return a matrix with these diagonals, from the main one upwards."""
    shape = (len(bands[0]), n)
    return sparse.csc_matrix(sparse.diags_array(bands, offsets=range(len(bands)), shape=shape))  # type: ignore[arg-type]
