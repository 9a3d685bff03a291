"""A prior learned from recordings: how instruments differ, and how one differs from session to session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.fleet.loops import FEATURES, MULTIPLES, LoopShape
from trocar.calibration.fleet.prior import FleetPrior
from trocar.calibration.models.drift import DriftWhitener
from trocar.calibration.plant import WRIST, fit_plant
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError

DRIFT = 0.3
"""Variance of the drift over that of the noise: of ``DRIFT_RATIOS``, what recordings show."""
RIDGE = np.array([0.0] + [0.05] * 3 + [0.15] * (FEATURES - 4))
"""Penalty on each weight of one recording's map: weights of neighbouring radii would trade places."""
OUTER_RIDGE = np.array([0.0] + [1.0] * 6)

LEAST_SHAPE_SD = np.array([0.4, 0.4, 0.4, 0.06, 0.06])
"""Of ``LoopShape.theta``: half a dozen recordings do not show every instrument; radii within a factor of 1.5."""
OFFSET_SD = 0.15
"""rad, least: offsets change whenever an instrument is mounted."""
OWN_SD = (0.02, 0.05, 0.10)
"""Least SD of a joint's error per rad of its own command: gain of roll, pitch, yaw."""
COUPLING_SD = 0.03
"""Least SD of a joint's error per rad of another one's command."""
SLACK_SD = 0.06 / np.sqrt(len(MULTIPLES))
"""Least SD of a joint's error per rad of slack."""
OUTER_OFFSET_SD = np.array([3e-3, 3e-3, 5e-4])
"""Of the errors of q1 q2 q3, least: rad, rad, m."""
COMMON = 0.5
"""Share of the least variances that is added to what the recordings show together."""


def learn_prior(recordings: Sequence[Recording]) -> FleetPrior:
    """Return the prior over instruments and sessions that recordings of some of them show.

    Raises:
        TrocarError: they are fewer than two.
    """
    if len(recordings) < 2:
        raise TrocarError(f"a prior cannot be learned from {len(recordings)} recordings; give two or more")
    fits = [_fit(recording) for recording in recordings]
    spread = np.sqrt(1.0 + 1.0 / len(fits))  # of the next one about the mean of these
    shapes, weights, outer, left = (np.array(part) for part in zip(*fits, strict=True))
    factors = []
    for joint in range(3):
        away = weights[:, joint] - weights[:, joint].mean(axis=0)
        covariance = spread**2 * away.T @ away / (len(fits) - 1) + COMMON * np.diag(_least_sd(joint) ** 2)
        factors.append(np.linalg.cholesky(covariance))
    outer_sd = np.sqrt(np.mean(outer**2, axis=0))
    outer_sd[:, 0] = np.maximum(outer[:, :, 0].std(axis=0), OUTER_OFFSET_SD)
    noise_sd = np.sqrt(np.median(left, axis=0))
    return FleetPrior(
        shape_mean=shapes.mean(axis=0),
        shape_sd=np.maximum(spread * shapes.std(axis=0, ddof=1), LEAST_SHAPE_SD),
        weights=weights.mean(axis=0),
        factors=np.array(factors),
        noise_sd=noise_sd[WRIST],
        outer_sd=outer_sd,
        outer_noise_sd=noise_sd[:3],
        sources=tuple(recording.name for recording in recordings),
    )


def outer_features(q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what the errors of q1 q2 q3 are linear in: 1 and the command (n, 7)."""
    return np.column_stack([np.ones(len(q_cmd)), q_cmd])


def _fit(recording: Recording) -> tuple[NDArray[np.float64], ...]:
    """Return the shape's parameters, the weights, those of the outer joints, and the variances (6,) that are left."""
    plant, valid = fit_plant(recording), recording.valid
    shape = LoopShape(plant.radii, plant.a, plant.b)
    error = (recording.q_phy - recording.q_cmd)[valid]
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    features = shape.features(recording.q_cmd)[valid]
    weights = _ridge(features, error[:, WRIST], RIDGE, whiten)
    outside = outer_features(recording.q_cmd)[valid]
    outer = _ridge(outside, error[:, :3], OUTER_RIDGE, whiten)
    left = np.concatenate([error[:, :3] - outside @ outer.T, error[:, WRIST] - features @ weights.T], axis=1)
    return shape.theta, weights, outer, np.mean(whiten(left) ** 2, axis=0)


def _ridge(
    x: NDArray[np.float64], y: NDArray[np.float64], penalty: NDArray[np.float64], whiten: DriftWhitener
) -> NDArray[np.float64]:
    x, y = whiten(x), whiten(y)
    return np.asarray(np.linalg.solve(x.T @ x + np.diag(penalty), x.T @ y).T, dtype=np.float64)


def _least_sd(joint: int) -> NDArray[np.float64]:
    """Return the least SDs (FEATURES,) of one joint's weights."""
    sd = np.full(FEATURES, SLACK_SD)
    sd[0], sd[1:4], sd[1 + joint] = OFFSET_SD, COUPLING_SD, OWN_SD[joint]
    return sd
