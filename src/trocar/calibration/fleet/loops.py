"""Hysteresis loops of one common shape, by which instruments are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.play_map import DriftWhitener
from trocar.calibration.plant import WRIST, fit_plant, play_slacks
from trocar.calibration.recording import Recording

MULTIPLES = np.array([0.4, 1.0, 1.8])
"""Radii of the play operators of a joint, in multiples of its backlash: real loops have round corners."""
FEATURES = 4 + 3 * len(MULTIPLES)
"""Number of inputs of the linear map to the errors of q4 q5 q6: 1, q4, q5, q6, then the slacks of each joint in
turn."""


@dataclass(frozen=True, eq=False)
class LoopShape:
    """The shape of the wrist's hysteresis loops, without the weights.

    Attributes:
        radii: (3,) backlash of roll, pitch, yaw, rad.
        a: share of yaw in the motion of the pitch cable.
        b: share of pitch in the motion of the yaw cable.
    """

    radii: NDArray[np.float64]
    a: float
    b: float

    @staticmethod
    def of(theta: NDArray[np.float64]) -> LoopShape:
        """Return the shape with these parameters (5,): logarithms of the radii, a, b."""
        return LoopShape(np.exp(theta[:3]), float(theta[3]), float(theta[4]))

    @property
    def theta(self) -> NDArray[np.float64]:
        """Return the parameters (5,)."""
        return np.array([*np.log(self.radii), self.a, self.b])

    @property
    def banks(self) -> NDArray[np.float64]:
        """Return the radii (3, k) of all operators."""
        return self.radii[:, None] * MULTIPLES

    def slacks(self, q_cmd: NDArray[np.float64], starts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slacks (n, 3, s, k) along commands (n, 6).

        Args:
            q_cmd: all commands since the arm was at rest.
            starts: (s,) slacks before the first one, as shares of the radii: -1 to 1.
        """
        shape = (3, len(starts), len(MULTIPLES))
        radii = np.broadcast_to(self.banks[:, None], shape)
        slacks = play_slacks(q_cmd, self.a, self.b, radii.reshape(3, -1), (starts[:, None] * radii).reshape(3, -1))
        return slacks.reshape(len(q_cmd), *shape)

    def features(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the features (n, FEATURES) along commands (n, 6) that start without slack."""
        slacks = self.slacks(q_cmd, np.zeros(1))
        return np.column_stack([np.ones(len(q_cmd)), q_cmd[:, WRIST], slacks.reshape(len(q_cmd), -1)])


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
