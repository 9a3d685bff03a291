"""The hysteresis loops of one recording, in a form in which instruments can be compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.fleet.loops import FEATURES, LoopShape
from trocar.calibration.models.drift import DriftWhitener
from trocar.calibration.plant import WRIST, fit_plant
from trocar.calibration.recording import Recording

DRIFT = 0.3
"""Variance of the drift over that of the noise: the value of ``DRIFT_RATIOS`` that recordings show."""
RIDGE = np.array([0.0] + [0.05] * 3 + [0.15] * (FEATURES - 4))
"""Penalty on each weight of one recording's map; without it, weights of neighbouring radii could be exchanged
freely."""
OUTER_RIDGE = np.array([0.0] + [1.0] * 6)


@dataclass(frozen=True, eq=False)
class LoopFit:
    """One recording's loops.

    Attributes:
        name: of the recording.
        shape: (5,) of ``LoopShape.theta``.
        weights: (3, FEATURES) of the map from ``LoopShape.features`` to the errors of q4 q5 q6.
        outer: (3, 7) of the errors of q1 q2 q3 as maps of 1 and the command, rad and m.
        left: (6,) variances of the errors that these maps leave.
    """

    name: str
    shape: NDArray[np.float64]
    weights: NDArray[np.float64]
    outer: NDArray[np.float64]
    left: NDArray[np.float64]


def outer_features(q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inputs (n, 7) of the linear maps for the errors of q1 q2 q3: 1 and the command."""
    return np.column_stack([np.ones(len(q_cmd)), q_cmd])


def fit_loops(recording: Recording) -> LoopFit:
    """Return the fit to one recording alone."""
    plant, valid = fit_plant(recording), recording.valid
    shape = LoopShape(plant.radii, plant.a, plant.b)
    error = (recording.q_phy - recording.q_cmd)[valid]
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    features = shape.features(recording.q_cmd)[valid]
    weights = _ridge(features, error[:, WRIST], RIDGE, whiten)
    outside = outer_features(recording.q_cmd)[valid]
    outer = _ridge(outside, error[:, :3], OUTER_RIDGE, whiten)
    left = np.concatenate([error[:, :3] - outside @ outer.T, error[:, WRIST] - features @ weights.T], axis=1)
    return LoopFit(recording.name, shape.theta, weights, outer, np.mean(whiten(left) ** 2, axis=0))


def _ridge(
    x: NDArray[np.float64], y: NDArray[np.float64], penalty: NDArray[np.float64], whiten: DriftWhitener
) -> NDArray[np.float64]:
    x, y = whiten(x), whiten(y)
    return np.asarray(np.linalg.solve(x.T @ x + np.diag(penalty), x.T @ y).T, dtype=np.float64)
