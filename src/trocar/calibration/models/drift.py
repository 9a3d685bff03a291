"""Whitening of drifting measurements, so that errors common to neighbouring rows count once, not once per row."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

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

    Attributes:
        carry: (n,) weight of the last prediction in the next one.
        gain: (n,) weight of the last row in the next prediction.
        sd: (n,) SD of a row about its prediction.
    """

    carry: NDArray[np.float64]
    gain: NDArray[np.float64]
    sd: NDArray[np.float64]

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

    def __call__(self, a: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``inverse(L) @ a``; (n, k) -> (n, k)."""
        inflow = np.zeros_like(a)
        inflow[1:] = self.gain[1:, None] * a[:-1]
        bands = np.stack([np.ones(len(a)), -np.append(self.carry[1:], 0.0)])
        return (a - solve_banded((1, 0), bands, inflow)) / self.sd[:, None]

    def log_likelihood(self, residuals: NDArray[np.float64]) -> float:
        """Return the log likelihood of residuals (n, k) up to a constant, each column with its most likely scale."""
        n, k = residuals.shape
        spread = np.mean(self(residuals) ** 2, axis=0) + 1e-12
        return float(-0.5 * n * np.log(spread).sum() - k * np.log(self.sd).sum())


def drift_ratio(rows: NDArray[np.int64], residuals: NDArray[np.float64]) -> float:
    """Return the most likely of :data:`DRIFT_RATIOS` for residuals (n, k) at rows (n,)."""
    return max(DRIFT_RATIOS, key=lambda ratio: DriftWhitener.of(rows, ratio).log_likelihood(residuals))
