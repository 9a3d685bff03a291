"""A Kalman filter for one error vector that learns how large the noise is, and in which direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

GATE = float(chi2.ppf(0.999, 3))
"""Squared Mahalanobis distance that one in a thousand good observations (3,) exceeds."""
NOISE_PASSES = 2
"""Fixed-point iterations between state and noise; a third changes the noise by less than a percent."""
DRIFT = slice(3, 6)
"""Indices of the drift in the state: after the constant (3,), before the gains."""


@dataclass(frozen=True, eq=False)
class ErrorEstimate:
    """The estimate of ``error = H x + noise`` with state x = (constant, drift, gains).

    The drift is an Ornstein-Uhlenbeck process, the rest is constant. The noise is normal with an unknown covariance
    (inverse Wishart), learned beside the state by variational Bayes (Sarkka and Nummenmaa 2009).

    Attributes:
        mean: (n,) of the state.
        covariance: (n, n).
        scatter: (3, 3) weighted sum of squared residuals so far, the prior's included.
        count: how many observations the scatter stands for.
        drift_sd: of each axis of the drift, in the unit of the error.
        drift_s: time in which the drift decays by 63 %.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    scatter: NDArray[np.float64]
    count: float
    drift_sd: float
    drift_s: float

    @staticmethod
    def prior(
        constant_sd: float, gain_sds: list[float], noise: tuple[float, float], drift: tuple[float, float]
    ) -> ErrorEstimate:
        """Return the belief before any observation.

        Args:
            constant_sd: of each axis of the constant.
            gain_sds: of each gain.
            noise: standard deviation per axis, and the number of observations that this guess is worth.
            drift: ``drift_sd`` and ``drift_s``.
        """
        sds = np.array([constant_sd] * 3 + [drift[0]] * 3 + gain_sds)
        return ErrorEstimate(
            np.zeros(len(sds)), np.diag(sds**2), noise[1] * noise[0] ** 2 * np.eye(3), noise[1], *drift
        )

    @property
    def noise(self) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of the noise."""
        return self.scatter / self.count

    def after(self, dt_s: float, wandered_sd: float = 0.0) -> ErrorEstimate:
        """Return the belief a time ``dt_s`` later, after an additional wander of the drift on each axis."""
        kept = np.exp(-dt_s / self.drift_s)
        decay = np.ones(len(self.mean))
        decay[DRIFT] = kept
        covariance = decay[:, None] * self.covariance * decay
        covariance[DRIFT, DRIFT] += (self.drift_sd**2 * (1 - kept**2) + wandered_sd**2) * np.eye(3)
        return replace(self, mean=decay * self.mean, covariance=covariance)

    def observed(self, H: NDArray[np.float64], error: NDArray[np.float64], weight: float = 1.0) -> ErrorEstimate:
        """Return the belief after an observation.

        One beyond the gate loses weight with its squared distance: a gross outlier hardly counts, but an error that
        really jumped is followed eventually, which a hard gate might never do.

        Args:
            H: (3, n).
            error: (3,) as observed.
            weight: in (0, 1], as a share of an independent observation.
        """
        surprise = error - H @ self.mean
        spread = H @ self.covariance @ H.T
        distance2 = surprise @ np.linalg.solve(spread + self.noise / weight, surprise)
        weight *= float(GATE / max(distance2, GATE))
        count, noise = self.count + weight, self.noise
        mean, covariance, scatter = self.mean, self.covariance, self.scatter
        for _ in range(NOISE_PASSES):
            gain = np.linalg.solve(spread + noise / weight, H @ self.covariance).T
            mean, covariance = self.mean + gain @ surprise, self.covariance - gain @ H @ self.covariance
            residual = error - H @ mean
            scatter = self.scatter + weight * (np.outer(residual, residual) + H @ covariance @ H.T)
            noise = scatter / count
        covariance = (covariance + covariance.T) / 2
        return replace(self, mean=mean, covariance=covariance, scatter=scatter, count=count)
