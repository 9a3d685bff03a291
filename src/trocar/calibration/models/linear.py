"""Linear cable models: a constant offset, and a linear map of a window of the last commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, WithOffset, commands, in_words, shaped
from trocar.calibration.recording import Recording
from trocar.geometry.arrays import Array

PRIOR_COMMANDS = 5  # number of prior commands in a window, in addition to the present one (paper, section IV-A)


def windows(q_cmd: Array) -> Array:
    """Return each sample's window, oldest first, (n, 6) -> (n, 1 + 5, 6); the arm is at rest before the first."""
    rows = np.arange(len(q_cmd))[:, None] + np.arange(-PRIOR_COMMANDS, 1)
    return q_cmd[np.maximum(rows, 0)]


def resting_window(q_cmd: Array) -> Array:
    """Return the prior commands (5, 6) of an arm that has been at rest at this command (6,)."""
    return np.repeat(q_cmd[None], PRIOR_COMMANDS, axis=0)


@dataclass(frozen=True, eq=False)
class OffsetModel(WithOffset):
    """``q_joint = q_cmd + offset``: no memory, no coupling."""

    name: ClassVar[str] = "offset"
    rate_independent: ClassVar[bool] = True
    offset: Array  # (6,) rad and m (q3)
    training: TrainingMotion  # the motion it was fitted on

    def __repr__(self) -> str:
        offsets = ", ".join(f"{x:.2f}" for x in np.degrees(self.offset[3:]))
        return in_words(self, f"offsets of q4 q5 q6 {offsets} deg")

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model with the mean error over the valid rows."""
        error = recording.errors[recording.valid]
        return cls(error.mean(axis=0), TrainingMotion.of(recording))

    def predict(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) for a history of commands (n, 6)."""
        return commands(q_cmd) + self.offset

    def start(self, q_cmd: Array) -> None:
        """Return None: the model has no state."""

    def step(self, state: None, q_cmd: Array) -> tuple[Array, None]:
        """Return the joints (6,) after the command (6,)."""
        return q_cmd + self.offset, None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        return {"offset": self.offset}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        return cls(shaped(arrays, offset=(6,))["offset"], training)


PENALTY = 1.0  # ridge penalty on standardised windows: about one sample in a thousand


@dataclass(frozen=True, eq=False)
class RidgeModel(WithOffset):
    """``q_joint = q_cmd + offset + W vec(window)``; the window is the command and five prior ones."""

    name: ClassVar[str] = "ridge"
    rate_independent: ClassVar[bool] = False
    weights: Array  # (36, 6) from window (oldest command first, joints contiguous) to errors
    offset: Array  # (6,) rad and m (q3)
    training: TrainingMotion  # the motion it was fitted on

    def __repr__(self) -> str:
        return in_words(self)

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model fitted by ridge regression on standardised inputs."""
        x = windows(recording.q_cmd).reshape(len(recording), -1)[recording.valid]
        error = recording.errors[recording.valid]
        mean, scale = x.mean(axis=0), x.std(axis=0)
        scale = np.where(scale > 1e-9, scale, np.inf)
        z = (x - mean) / scale
        normal = z.T @ z + PENALTY * np.eye(z.shape[1])
        weights = np.linalg.solve(normal, z.T @ (error - error.mean(axis=0))) / scale[:, None]
        return cls(weights, error.mean(axis=0) - mean @ weights, TrainingMotion.of(recording))

    def predict(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) for a history of commands (n, 6)."""
        q = commands(q_cmd)
        return q + self.offset + windows(q).reshape(len(q), -1) @ self.weights

    def start(self, q_cmd: Array) -> Array:
        """Return the prior commands (5, 6) of an arm at rest."""
        return resting_window(q_cmd)

    def step(self, state: Array, q_cmd: Array) -> tuple[Array, Array]:
        """Return the joints (6,) after the command (6,), and the new prior commands."""
        window = np.concatenate([state, q_cmd[None]])
        return q_cmd + self.offset + window.ravel() @ self.weights, window[1:]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        return {"weights": self.weights, "offset": self.offset}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        own = shaped(arrays, weights=(6 * (PRIOR_COMMANDS + 1), 6), offset=(6,))
        return cls(own["weights"], own["offset"], training)
