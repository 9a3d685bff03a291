"""The simplest cable model: a constant error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, commands, in_words, shaped
from trocar.calibration.recording import Recording


@dataclass(frozen=True, eq=False)
class OffsetModel:
    """``q_joint = q_cmd + offset``: no memory, no coupling.

    Attributes:
        offset: (6,) rad and m (q3).
        training: the motion it was fitted on.
    """

    name: ClassVar[str] = "offset"
    rate_independent: ClassVar[bool] = True
    offset: NDArray[np.float64]
    training: TrainingMotion

    def __repr__(self) -> str:
        offsets = ", ".join(f"{x:.2f}" for x in np.degrees(self.offset[3:]))
        return in_words(self, f"offsets of q4 q5 q6 {offsets} deg")

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model with the mean error over the valid rows."""
        error = (recording.q_phy - recording.q_cmd)[recording.valid]
        return cls(error.mean(axis=0), TrainingMotion.of(recording))

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) for a history of commands (n, 6)."""
        return commands(q_cmd) + self.offset

    def start(self, q_cmd: NDArray[np.float64]) -> None:
        """Return None: the model has no state."""

    def step(self, state: None, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], None]:
        """Return the joints (6,) after the command (6,)."""
        return q_cmd + self.offset, None

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model with this offset (6,) added to its predictions."""
        return replace(self, offset=self.offset + offset)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        return {"offset": self.offset}

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        return cls(shaped(arrays, offset=(6,))["offset"], training)
