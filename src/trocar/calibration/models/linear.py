"""A linear map from the last commands: the memory of a window, without a network."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, commands, in_words, shaped
from trocar.calibration.models.linear import PRIOR_COMMANDS, advance, resting_window, windows
from trocar.calibration.recording import Recording

PENALTY = 1.0
"""Ridge penalty on standardised windows: about one sample in a thousand."""


@dataclass(frozen=True, eq=False)
class RidgeModel:
    """``q_joint = q_cmd + offset + W vec(window)``; the window is the command and five prior ones.

    Attributes:
        weights: (36, 6) from window (oldest command first, joints contiguous) to errors.
        offset: (6,) rad and m (q3).
        training: the motion it was fitted on.
    """

    name: ClassVar[str] = "ridge"
    rate_independent: ClassVar[bool] = False
    weights: NDArray[np.float64]
    offset: NDArray[np.float64]
    training: TrainingMotion

    def __repr__(self) -> str:
        return in_words(self)

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model fitted by ridge regression on standardised inputs."""
        x = windows(recording.q_cmd).reshape(len(recording), -1)[recording.valid]
        error = (recording.q_phy - recording.q_cmd)[recording.valid]
        mean, scale = x.mean(axis=0), x.std(axis=0)
        scale = np.where(scale > 1e-9, scale, np.inf)
        z = (x - mean) / scale
        normal = z.T @ z + PENALTY * np.eye(z.shape[1])
        weights = np.linalg.solve(normal, z.T @ (error - error.mean(axis=0))) / scale[:, None]
        return cls(weights, error.mean(axis=0) - mean @ weights, TrainingMotion.of(recording))

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) for a history of commands (n, 6)."""
        q = commands(q_cmd)
        return q + self.offset + windows(q).reshape(len(q), -1) @ self.weights

    def start(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the prior commands (5, 6) of an arm at rest."""
        return resting_window(q_cmd)

    def step(
        self, state: NDArray[np.float64], q_cmd: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joints (6,) after the command (6,), and the new prior commands."""
        window = advance(state, q_cmd)
        return q_cmd + self.offset + window.ravel() @ self.weights, window[1:]

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model with this offset (6,) added to its predictions."""
        return replace(self, offset=self.offset + offset)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        return {"weights": self.weights, "offset": self.offset}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        own = shaped(arrays, weights=(6 * (PRIOR_COMMANDS + 1), 6), offset=(6,))
        return cls(own["weights"], own["offset"], training)
