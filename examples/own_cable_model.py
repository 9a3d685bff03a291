"""A cable model of your own: the error of each joint as a plane over the commands, without memory.

trocar calibrate fit RECORDING.npz --plugin examples/own_cable_model.py --model plane --out plane.npz
trocar calibrate evaluate plane.npz RECORDING.npz --plugin examples/own_cable_model.py
trocar run --plugin examples/own_cable_model.py peg-transfer --model plane --trials 1 --seed 3 --out out/plane
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models import MODELS
from trocar.calibration.models.base import Arrays, TrainingMotion, commands, shaped
from trocar.calibration.recording import Recording


@dataclass(frozen=True, eq=False)
class PlaneModel:
    """``q_joint = q_cmd + offset + slope @ q_cmd``, from a least-squares fit.

    Attributes:
        offset: (6,) rad and m (q3).
        slope: (6, 6).
        training: the motion that it was fitted on.
    """

    name: ClassVar[str] = "plane"
    rate_independent: ClassVar[bool] = True
    offset: NDArray[np.float64]
    slope: NDArray[np.float64]
    training: TrainingMotion

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the plane through the errors of the valid rows."""
        q, valid = recording.q_cmd, recording.valid
        error = (recording.q_phy - q)[valid]
        weights = np.linalg.lstsq(np.column_stack([np.ones(valid.sum()), q[valid]]), error, rcond=None)[0]
        return cls(weights[0], weights[1:].T, TrainingMotion.of(recording))

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) along a history of commands (n, 6)."""
        q = commands(q_cmd)
        return q + self.offset + q @ self.slope.T

    def start(self, q_cmd: NDArray[np.float64]) -> None:
        """Return the memory of an arm at rest: there is none."""

    def step(self, state: None, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], None]:
        """Return the joints (6,) after the command (6,)."""
        return q_cmd + self.offset + self.slope @ q_cmd, None

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model of another session, whose joints are offset by this much (6,)."""
        return replace(self, offset=self.offset + offset)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what its file stores."""
        return {"offset": self.offset, "slope": self.slope}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model of a file."""
        return cls(**shaped(arrays, offset=(6,), slope=(6, 6)), training=training)


MODELS.register(PlaneModel.name, PlaneModel)
