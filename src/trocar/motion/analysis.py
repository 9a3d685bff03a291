"""Velocities, accelerations and jerk of recorded joints and of the tool tip, from measured positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import sparse

from trocar.arms import ArmModel, fk, jacobian
from trocar.errors import InvalidInput, NoPlan
from trocar.geometry.arrays import Array
from trocar.motion.qp import Program

# Where the Huber losses become linear, in standard deviations: within 5 % of least squares on Gaussian noise.
THRESHOLD = 1.345
WINDOW, OVERLAP = 2000, 100  # samples solved at once, and shared by two windows, each of which supplies half of them
CHOSEN_ON = 800  # number of samples used in cross-validation, where the signal moves most
DECADES, FIRST_DECADE = (-3, 7), 1  # the weights of cross-validation: a descent by decades, then by half decades
HELD_OUT = 7  # one in this many samples is held out, to be predicted
PRECISION = 1e-6  # of the solver, in standard deviations of the noise
FINEST = 1e-7  # the noise is assumed to be at least this share of the signal's range: single precision
SHORTEST = 16  # minimum number of samples of a signal
KINDS = ("velocity", "acceleration", "jerk")
HALF_STEP_S = 1e-4  # of the central difference that gives the Jacobian's change along a motion


@dataclass(frozen=True, eq=False)
class Derivatives:
    """One signal, or several that were measured together, with derivatives.

    Attributes:
        position: (n,) or (n, k) as estimated, in the signals' units.
        velocity: likewise, per second.
        acceleration: likewise, per second squared.
        step_s: between samples.
    """

    position: Array
    velocity: Array
    acceleration: Array
    step_s: float

    @property
    def jerk(self) -> Array:
        """Return the jerk (n - 1, k) between samples: the difference of accelerations over the step."""
        return np.diff(self.acceleration, axis=0) / self.step_s

    def rms(self) -> dict[str, Array]:
        """Return the root mean square (k,) of velocity, acceleration and jerk over the whole recording."""
        return {name: np.sqrt(np.mean(getattr(self, name) ** 2, axis=0)) for name in KINDS}

    def largest(self) -> dict[str, Array]:
        """Return the largest magnitude (k,) of velocity, acceleration and jerk."""
        return {name: np.abs(getattr(self, name)).max(axis=0) for name in KINDS}


@dataclass(frozen=True, eq=False)
class JointAnalysis:
    """The motion of an arm's six joints (rad and m) and of the tool tip in its base frame (m)."""

    joints: Derivatives
    tip: Derivatives

    @property
    def path_m(self) -> float:
        """Return the length of the tip's path."""
        return float(np.linalg.norm(np.diff(self.tip.position, axis=0), axis=1).sum())


def analyse(measured: Array, step_s: float, smoothness: float | None = None) -> Derivatives:
    """Return the derivatives of signals (n, k), each estimated separately as by ``estimate``."""
    if measured.ndim != 2:
        raise InvalidInput("signals", f"have shape {measured.shape}", "give (samples, signals)")
    found = [estimate(column, step_s, smoothness) for column in measured.T]
    q, v, a = (np.column_stack([getattr(one, name) for one in found]) for name in ("position", *KINDS[:2]))
    return Derivatives(q, v, a, step_s)


def analyse_joints(arm: ArmModel, measured: Array, step_s: float, smoothness: float | None = None) -> JointAnalysis:
    """Return the motion of an arm's joints and of its tip, from measured joints (n, 6) in rad and m.

    The tip's velocity and acceleration follow from the joints': ``J q'`` and ``J q'' + J' q'``.
    """
    joints = analyse(measured, step_s, smoothness)
    q, dq, ddq = joints.position, joints.velocity, joints.acceleration
    J = jacobian(arm, q)[:, :3]
    ahead, behind = (jacobian(arm, q + side * HALF_STEP_S * dq)[:, :3] for side in (1.0, -1.0))
    change = (ahead - behind) / (2.0 * HALF_STEP_S)
    tip = Derivatives(
        fk(arm, q).translation_m,
        np.einsum("nij,nj->ni", J, dq),
        np.einsum("nij,nj->ni", J, ddq) + np.einsum("nij,nj->ni", change, dq),
        step_s,
    )
    return JointAnalysis(joints, tip)


def estimate(measured: Array, step_s: float, smoothness: float | None = None) -> Derivatives:
    """Return the motion behind one measured signal.

    After Hwang et al. 2022, section IV-E, which follows Todorov and Jordan (1998). Their program as printed leaves
    the velocity at the start free and can meet every noisy sample exactly; this one is amended in two places
    (docs/motion.md). It minimises, over positions p, velocities v and accelerations a::

        sum huber((q_t - p_t) / s) + sum huber(sqrt(w) (a_t+1 - a_t) T^2 / s)
        p_t+1 = p_t + v_t T + (2 a_t + a_t+1) T^2 / 6
        v_t+1 = v_t + (a_t + a_t+1) T / 2

    So outliers count linearly, and so do jumps of the acceleration, which time-optimal motions have. The noise s is
    estimated from sixth differences; the weight w is the one that predicts held-out samples best.

    Args:
        measured: (n,) at even steps; NaN where there is no measurement.
        step_s: between samples.
        smoothness: w; None: by cross-validation.
    """
    there = np.isfinite(measured)
    if measured.ndim != 1 or len(measured) < SHORTEST or np.count_nonzero(there) < len(measured) / 2:
        got = f"got shape {measured.shape}, {np.count_nonzero(there)} measured"
        raise InvalidInput("a signal", f"needs {SHORTEST} or more samples (n,), half of them measured", got)
    if not step_s > 0:
        raise InvalidInput("the time between samples", f"is {step_s} s", "give a time above 0")
    times = np.arange(len(measured))
    bridged = np.interp(times, times[there], measured[there])
    reach, middle = float(np.ptp(bridged)), float(np.median(bridged))
    if reach == 0.0:
        return Derivatives(bridged, 0 * bridged, 0 * bridged, step_s)
    noise = max(noise_sd(bridged), FINEST * reach)
    scaled, kept = (bridged - middle) / noise, there.astype(np.float64)
    if smoothness is None:
        where = _liveliest(scaled)
        smoothness = _best_weight(scaled[where], kept[where])
    p, v, a = _in_windows(scaled, smoothness, kept)
    return Derivatives(middle + noise * p, noise * v / step_s, noise * a / step_s**2, step_s)


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
    """Return the smoothness weight that predicts held-out samples best (mean Huber loss)."""
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

    The variables are p, v, a (n each), then the linear parts of the Huber losses: above and below each measurement
    (n each), above and below each jump of the acceleration (n - 1 each). A measurement counts where ``kept`` (n,) is 1.
    """
    n = len(scaled)
    here, ahead = sparse.eye(n - 1, n, format="csc"), sparse.eye(n - 1, n, k=1, format="csc")
    change, measured, jump = ahead - here, sparse.diags(kept).tocsc(), sparse.eye(n - 1, format="csc")
    free, losses = sparse.csc_matrix((n, n)), sparse.csc_matrix((n - 1, 4 * n - 2))
    residuals = [  # the squared terms
        [measured, free, free, measured, -measured, None, None],
        [None, None, np.sqrt(weight) * change, None, None, -jump, jump],
    ]
    dynamics = [  # between samples, with T and T squared absorbed into v and a
        [change, -here, -(here / 3 + ahead / 6), losses],
        [None, change, -(here / 2 + ahead / 2), None],
    ]
    matrix = sparse.bmat(residuals, format="csc")
    linear = -(matrix.T @ np.concatenate([kept * scaled, np.zeros(n - 1)]))
    linear[3 * n :] += THRESHOLD
    lower = np.where(np.arange(len(linear)) < 3 * n, -np.inf, 0.0)
    program = Program("motion", (matrix.T @ matrix).tocsc(), linear, lower, None, PRECISION, PRECISION)
    program.keep("dynamics", sparse.bmat(dynamics, format="csr"), 0.0, 0.0)
    try:
        p, v, a = program.least()[: 3 * n].reshape(3, n)
    except NoPlan as error:
        problem = f"could be fitted to {n} samples ({error})"
        raise InvalidInput("no motion", problem, "give positions at even steps") from None
    return p, v, a
