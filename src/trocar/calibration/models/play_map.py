"""The learned map of the play model: linear in commands and slacks, plus smooth bumps near the training data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, sqrt
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_banded

from trocar.calibration.models.base import Arrays, shaped
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array

DRIFT_RATIOS = (0.0, 0.3)
"""Candidate ratios of the drift's variance to that of the independent noise: none, or the best in forward chaining over
five recordings; the likelihood of the residuals decides."""

DRIFT_ROWS = 20.0
"""Correlation length of the drift: its autocorrelation falls to 1/e after this many rows; chosen in the same way."""


@dataclass(frozen=True, eq=False)
class DriftWhitener:
    """Whitens noise that is the sum of white noise and drift, an Ornstein-Uhlenbeck process over the rows.

    ``white(a) = inverse(L) @ a`` with ``L L^T = I + ratio exp(-|i - j| / DRIFT_ROWS)`` over the rows i, j, in linear
    time: the innovations of a Kalman filter, each divided by its standard deviation.
    """

    carry: Array  # (n,) weight of the last prediction in the next one
    gain: Array  # (n,) weight of the last row in the next prediction
    sd: Array  # (n,) SD of a row about its prediction

    @classmethod
    def of(cls, rows: NDArray[np.int64], ratio: float) -> Self:
        """Return the whitener for this ratio of drift at rows (n,), which increase and may have gaps."""
        carry, gain, sd = np.zeros(len(rows)), np.zeros(len(rows)), np.ones(len(rows))
        # Kalman filter of the drift: ``variance`` is that of its prediction, ``share`` the filter's gain.
        variance, share = ratio, 0.0
        for k, step in enumerate(np.diff(rows, prepend=rows[:1]).tolist()):
            kept = exp(-step / DRIFT_ROWS)
            if k:
                carry[k], gain[k] = kept * (1.0 - share), kept * share
                variance = kept * kept * variance * (1.0 - share) + ratio * (1.0 - kept * kept)
            share = variance / (variance + 1.0)
            sd[k] = sqrt(variance + 1.0)
        return cls(carry, gain, sd)

    def __call__(self, a: Array) -> Array:
        """Return ``inverse(L) @ a``; (n, k) -> (n, k)."""
        inflow = np.zeros_like(a)
        inflow[1:] = self.gain[1:, None] * a[:-1]
        bands = np.stack([np.ones(len(a)), -np.append(self.carry[1:], 0.0)])
        return (a - solve_banded((1, 0), bands, inflow)) / self.sd[:, None]

    def log_likelihood(self, residuals: Array) -> float:
        """Return the log likelihood of residuals (n, k) up to a constant, each column with its most likely scale."""
        n, k = residuals.shape
        spread = np.mean(self(residuals) ** 2, axis=0) + 1e-12
        return float(-0.5 * n * np.log(spread).sum() - k * np.log(self.sd).sum())


def drift_ratio(rows: NDArray[np.int64], residuals: Array) -> float:
    """Return the most likely of :data:`DRIFT_RATIOS` for residuals (n, k) at rows (n,)."""
    return max(DRIFT_RATIOS, key=lambda ratio: DriftWhitener.of(rows, ratio).log_likelihood(residuals))


BLOCKS = 5  # number of time blocks of the inner validation; each is predicted from the others
LENGTH = 3.0  # width of a bump in SDs of its inputs: wide enough for a map that bends slowly and stays invertible
CENTRES = 400  # maximum number of bumps, which are centred on training samples evenly spaced in time
PENALTIES = (3.0, 30.0)
NOISE_RATIOS = (0.1, 1.0, np.inf)
"""Candidates of the inner validation: ridge penalties on standardised linear features, and ratios of noise to signal
variance of the bumps (inf: no bumps)."""


@dataclass(frozen=True, eq=False)
class PlayMap:
    """``linear @ x + bumps @ exp(-|z - c|^2 / 2)``, ``z = (x[inputs] - mean) / scale``."""

    linear: Array  # (3, d) weights of all features x = [q4 q5 q6, slacks]
    inputs: NDArray[np.int64]  # (p,) indices of the bumps' inputs: the commands and the slacks of the identified radii
    mean: Array  # (p,) means of the inputs
    scale: Array  # (p,) SDs of the inputs times the bumps' width
    centres: Array  # (m, p) centres of the bumps in z
    bumps: Array  # (3, m) weights of the bumps

    def __call__(self, x: Array) -> Array:
        """Return the errors of q4 q5 q6; (..., d) -> (..., 3)."""
        value = x @ self.linear.T
        if len(self.centres):
            value += _kernel((x[..., self.inputs] - self.mean) / self.scale, self.centres) @ self.bumps.T
        return value

    def linearize(self, x: Array) -> tuple[Array, Array]:
        """Return the errors (3,) at x (d,) and their gradient (3, d)."""
        value, gradient = self.linear @ x, self.linear.copy()
        if len(self.centres):
            away = self.centres - (x[self.inputs] - self.mean) / self.scale
            weighted = self.bumps * np.exp(-0.5 * np.einsum("ij,ij->i", away, away))
            value += weighted.sum(axis=1)
            gradient[:, self.inputs] += (weighted @ away) / self.scale
        return value, gradient

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Return the errors (n, 3) at many x (n, d) and their gradients (n, 3, d)."""
        value = x @ self.linear.T
        gradient = np.tile(self.linear, (len(x), 1, 1))
        if len(self.centres):
            z = (x[:, self.inputs] - self.mean) / self.scale
            kernel = _kernel(z, self.centres)
            bumps = kernel @ self.bumps.T
            value += bumps
            pull = (kernel @ self._bumps_times_centres).reshape(len(x), 3, -1)
            gradient[:, :, self.inputs] += (pull - bumps[:, :, None] * z[:, None]) / self.scale
        return value, gradient

    @cached_property
    def _bumps_times_centres(self) -> Array:
        """Return (m, 3 p): the terms that the kernel's gradient sums over the centres."""
        return np.einsum("jm,mp->mjp", self.bumps, self.centres).reshape(len(self.centres), -1)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        return {f"map_{key}": getattr(self, key) for key in self.__dataclass_fields__}

    @classmethod
    def from_arrays(cls, arrays: Arrays, radii: int) -> PlayMap:
        """Return the map from a file's arrays, of a model with this many play operators for each joint."""
        features = 3 + 3 * radii
        own = shaped(
            arrays,
            map_linear=(3, features),
            map_inputs=("p",),
            map_mean=("p",),
            map_scale=("p",),
            map_centres=("m", "p"),
            map_bumps=(3, "m"),
        )
        inputs, scale = own["map_inputs"], own["map_scale"]
        if inputs.dtype.kind not in "iu" or ((inputs < 0) | (inputs >= features)).any() or (scale <= 0).any():
            raise InvalidInput("'map_inputs' or 'map_scale'", "are not valid")
        return cls(**{key: own[f"map_{key}"] for key in cls.__dataclass_fields__})


def fit_map(x: Array, y: Array, rows: NDArray[np.int64]) -> tuple[PlayMap, Array]:
    """Return the map from features (n, d) to errors (n, 3) at these rows, and the constant (3,) to add to it.

    Least squares account for slow drift (:class:`DriftWhitener`) if the residuals of a first fit show it. Ridge penalty
    and noise ratio are chosen per joint by the squared error over :data:`BLOCKS` blocks of time, each predicted from
    the others.
    """
    blocks = np.array_split(np.arange(len(x)), BLOCKS)
    candidates = [(penalty, ratio) for penalty in PENALTIES for ratio in NOISE_RATIOS]
    ((first, constant),) = _fits(x, y, rows, 0.0, [(PENALTIES[0], NOISE_RATIOS[1])])
    drift = drift_ratio(rows, y - first(x) - constant)
    scores = np.zeros((len(candidates), y.shape[1]))
    for block in blocks:
        train = np.setdiff1d(np.arange(len(x)), block)
        for i, (fitted, constant) in enumerate(_fits(x[train], y[train], rows[train], drift, candidates)):
            scores[i] += ((fitted(x[block]) + constant - y[block]) ** 2).sum(axis=0)
    fits = _fits(x, y, rows, drift, candidates)
    best = [fits[i] for i in scores.argmin(axis=0)]
    first = best[0][0]
    linear = np.array([fitted.linear[j] for j, (fitted, _) in enumerate(best)])
    bumps = np.array([fitted.bumps[j] for j, (fitted, _) in enumerate(best)])
    constant = np.array([constant[j] for j, (_, constant) in enumerate(best)])
    used = slice(None) if bumps.any() else slice(0)
    return (PlayMap(linear, first.inputs, first.mean, first.scale, first.centres[used], bumps[:, used]), constant)


def _fits(
    x: Array, y: Array, rows: NDArray[np.int64], drift: float, candidates: list[tuple[float, float]]
) -> list[tuple[PlayMap, Array]]:
    """Return the map and its constant for each (penalty, noise ratio)."""
    slacks_per_joint = (x.shape[1] - 3) // 3
    inputs = np.concatenate([np.arange(3), 3 + slacks_per_joint * np.arange(3)])
    mean, scale = x[:, inputs].mean(axis=0), _scale(x[:, inputs]) * LENGTH
    z = (x[:, inputs] - mean) / scale
    centres = z[np.unique(np.linspace(0, len(z) - 1, min(CENTRES, len(z))).round().astype(int))]
    # Gaussian-process regression of the linear part's residuals on inducing points, the bumps' centres; factorised once
    # for each noise ratio.
    kernel, prior = _kernel(z, centres), _kernel(centres, centres)
    whiten = DriftWhitener.of(rows, drift)
    white = whiten(kernel)
    normal = white.T @ white
    jitter = 1e-8 * len(z) * np.eye(len(centres))
    factors = {ratio: cho_factor(normal + ratio * prior + jitter) for _, ratio in candidates if np.isfinite(ratio)}
    lines = {penalty: fit_linear(x, y, penalty, whiten) for penalty, _ in candidates}
    fits = []
    for penalty, ratio in candidates:
        linear, constant = lines[penalty]
        bumps = np.zeros((y.shape[1], len(centres)))
        if ratio in factors:
            bumps = cho_solve(factors[ratio], white.T @ whiten(y - x @ linear.T - constant)).T
        fits.append((PlayMap(linear, inputs, mean, scale, centres, bumps), constant))
    return fits


def fit_linear(x: Array, y: Array, penalty: float, whiten: DriftWhitener | None = None) -> tuple[Array, Array]:
    """Return weights (outputs, d) and constant (outputs,) of a ridge regression on standardised features."""
    mean, scale = x.mean(axis=0), _scale(x)
    z = np.column_stack([np.ones(len(x)), (x - mean) / scale])
    if whiten is not None:
        z, y = whiten(z), whiten(y)
    ridge = np.diag([0.0] + [penalty] * x.shape[1])
    weights = np.linalg.solve(z.T @ z + ridge, z.T @ y)
    linear = (weights[1:] / scale[:, None]).T
    return linear, weights[0] - linear @ mean


def _scale(x: Array) -> Array:
    """Return the SD of each column; infinite for constant columns, which then have no weight."""
    sd = x.std(axis=0)
    return np.where(sd > 1e-9, sd, np.inf)


def _kernel(z: Array, centres: Array) -> Array:
    """Return ``exp(-|z - c|^2 / 2)``; (..., p), (m, p) -> (..., m)."""
    square = np.sum(z * z, -1)[..., None] + np.sum(centres * centres, -1) - 2.0 * z @ centres.T
    return np.exp(-0.5 * np.maximum(square, 0.0))
