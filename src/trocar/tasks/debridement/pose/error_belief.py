"""A Kalman filter for one error vector that learns how large the noise is, and in which direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

GATE = float(chi2.ppf(0.999, 3))
"""Squared Mahalanobis distance of an observation (3,) that one in a thousand good ones exceeds."""
NOISE_PASSES = 2
"""Passes of the fixed point between state and noise; a third changes the noise by less than a percent."""
DRIFT = slice(3, 6)
"""Where in the state the drift stands: after the constant (3,), before the gains."""


@dataclass(frozen=True, eq=False)
class ErrorBelief:
    """What is believed of ``error = H x + noise`` with state x = (constant, drift, gains).

    The drift is an Ornstein-Uhlenbeck process, the rest stands still. The noise is normal with an unknown covariance
    (inverse Wishart), learned beside the state by variational Bayes (Sarkka and Nummenmaa 2009).

    Attributes:
        mean: (n,) of the state.
        covariance: (n, n).
        scatter: (3, 3) weighted sum of squared residuals so far, the prior's included.
        count: how many observations the scatter stands for.
        drift_sd: of each axis of the drift, in the unit of the error.
        drift_s: time in which the drift forgets 63 % of itself.
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
    ) -> ErrorBelief:
        """Return the belief before any observation.

        Args:
            constant_sd: of each axis of the constant.
            gain_sds: of each gain.
            noise: standard deviation per axis, and how many observations this guess weighs as much as.
            drift: ``drift_sd`` and ``drift_s``.
        """
        sds = np.array([constant_sd] * 3 + [drift[0]] * 3 + gain_sds)
        return ErrorBelief(np.zeros(len(sds)), np.diag(sds**2), noise[1] * noise[0] ** 2 * np.eye(3), noise[1], *drift)

    @property
    def noise(self) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of the noise."""
        return self.scatter / self.count

    def after(self, dt_s: float, wandered_sd: float = 0.0) -> ErrorBelief:
        """Return the belief a time ``dt_s`` later, the drift of each axis having wandered by so much besides."""
        kept = np.exp(-dt_s / self.drift_s)
        decay = np.ones(len(self.mean))
        decay[DRIFT] = kept
        covariance = decay[:, None] * self.covariance * decay
        covariance[DRIFT, DRIFT] += (self.drift_sd**2 * (1 - kept**2) + wandered_sd**2) * np.eye(3)
        return replace(self, mean=decay * self.mean, covariance=covariance)

    def observed(self, H: NDArray[np.float64], error: NDArray[np.float64], weight: float = 1.0) -> ErrorBelief:
        """Return the belief after an observation.

        One beyond the gate loses weight with its squared distance: a gross outlier hardly counts, and yet an error that
        really jumped is followed in the end, which a gate that shuts might never do.

        Args:
            H: (3, n).
            error: (3,) as observed.
            weight: in (0, 1], how much of an independent observation this is.
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
