"""The paper's network, an LSTM of 256 units and two dense layers of 256, evaluated in NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, WithOffset, commands, in_words, shaped
from trocar.calibration.models.linear import resting_window, windows
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.extras import how_to_install
from trocar.geometry.arrays import Array

HIDDEN = 256  # number of units of the recurrent and of each dense layer (paper, section IV-A)

SHAPES = {
    "input": (4 * HIDDEN, 6),
    "recurrent": (4 * HIDDEN, HIDDEN),
    "bias": (4 * HIDDEN,),
    "dense1": (HIDDEN, HIDDEN),
    "bias1": (HIDDEN,),
    "dense2": (HIDDEN, HIDDEN),
    "bias2": (HIDDEN,),
    "out": (6, HIDDEN),
    "bias_out": (6,),
}
"""Shapes of the network's weights, by name; the gates are in the order i f g o."""

Weights = dict[str, NDArray[np.floating]]
Memory = tuple[NDArray[np.floating], NDArray[np.floating]]  # state of the recurrent layer: hidden and cell (..., h)


@dataclass(frozen=True, eq=False)
class LstmModel(WithOffset):
    """``q_joint = q_cmd + scale * network(window) + offset``; the window is the command and five prior ones."""

    name: ClassVar[str] = "lstm"
    rate_independent: ClassVar[bool] = False
    weights: Weights  # by name; single precision, as in training: accurate to 1e-6 of the error's SD
    input_mean: Array  # (6,) mean of the training commands
    input_scale: Array  # (6,) SD of the training commands
    error_scale: Array  # (6,) SD of the training errors
    offset: Array  # (6,) mean of the training errors
    training: TrainingMotion  # the motion it was fitted on

    def __repr__(self) -> str:
        return in_words(self)

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the network trained by AdamW on the mean squared error; needs the extra ``learn``."""
        training = TrainingMotion.of(recording)
        x = windows(recording.q_cmd)[recording.valid]
        error = recording.errors[recording.valid]
        mean, scale = x[:, -1].mean(axis=0), _scale(x[:, -1])
        offset, error_scale = error.mean(axis=0), _scale(error)
        try:
            from trocar.calibration.lstm_training import train  # using a trained network imports no framework
        except ModuleNotFoundError as missing:
            raise InvalidInput("training 'lstm'", f"needs {missing.name!r}", f"{how_to_install('learn')}") from None
        weights = train((x - mean) / scale, (error - offset) / error_scale, HIDDEN, rng)
        return cls(weights, mean, scale, error_scale, offset, training)

    def predict(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) for a history of commands (n, 6)."""
        q = commands(q_cmd)
        hidden, _ = remember(self.weights, self._standard(windows(q)))
        return q + (self.offset + self.error_scale * dense(self.weights, hidden))

    def start(self, q_cmd: Array) -> LstmState:
        """Return the state of an arm that has been at rest at this command (6,)."""
        return LstmState(self, resting_window(q_cmd))

    def step(self, state: LstmState, q_cmd: Array) -> tuple[Array, LstmState]:
        """Return the joints (6,) after the command (6,), and the new state."""
        hidden, _ = recur(self.weights, self._standard(q_cmd), state.memory)
        joints = q_cmd + self.offset + self.error_scale * dense(self.weights, hidden)
        return joints, LstmState(self, np.concatenate([state.prior[1:], q_cmd[None]]))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        own = {key: getattr(self, key) for key in ("input_mean", "input_scale", "error_scale", "offset")}
        return own | {f"weight_{key}": value for key, value in self.weights.items()}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        own = shaped(arrays, input_mean=(6,), input_scale=(6,), error_scale=(6,), offset=(6,))
        found = shaped(arrays, **{f"weight_{key}": shape for key, shape in SHAPES.items()})
        weights = {key: np.ascontiguousarray(found[f"weight_{key}"], dtype=np.float32) for key in SHAPES}
        return cls(weights=weights, training=training, **own)

    def _standard(self, q_cmd: Array) -> NDArray[np.floating]:
        return ((q_cmd - self.input_mean) / self.input_scale).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LstmState:
    """The prior commands (5, 6) of a window; the network processes them once for all candidate next commands."""

    model: LstmModel
    prior: Array

    @cached_property
    def memory(self) -> Memory:
        """The recurrent layer's state after the prior commands."""
        return remember(self.model.weights, self.model._standard(self.prior))


def recur(weights: Weights, z: NDArray[np.floating], memory: Memory) -> Memory:
    """Return the recurrent layer's state after one more standardised command (..., 6)."""
    hidden, cell = memory
    gates = z @ weights["input"].T + hidden @ weights["recurrent"].T + weights["bias"]
    i, f, g, o = np.split(gates, 4, axis=-1)
    cell = _sigmoid(f) * cell + _sigmoid(i) * np.tanh(g)
    return _sigmoid(o) * np.tanh(cell), cell


def remember(weights: Weights, z: NDArray[np.floating]) -> Memory:
    """Return the recurrent layer's state after standardised windows (..., steps, 6), starting from zero."""
    zero = np.zeros((*z.shape[:-2], weights["recurrent"].shape[1]), dtype=np.float32)
    memory = (zero, zero)
    for moment in range(z.shape[-2]):
        memory = recur(weights, z[..., moment, :], memory)
    return memory


def dense(weights: Weights, hidden: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the network's output (..., 6) for the hidden units (..., h) after a window."""
    layer = np.maximum(hidden @ weights["dense1"].T + weights["bias1"], 0.0)
    layer = np.maximum(layer @ weights["dense2"].T + weights["bias2"], 0.0)
    return layer @ weights["out"].T + weights["bias_out"]


def _sigmoid(x: NDArray[np.floating]) -> NDArray[np.floating]:
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def _scale(x: Array) -> Array:
    sd = x.std(axis=0)
    return np.where(sd > 1e-9, sd, 1.0)
