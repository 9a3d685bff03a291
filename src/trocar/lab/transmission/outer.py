"""Errors of the outer joints q1 q2 q3 of a cable-driven arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.lab.transmission.history_field import HistoryField

MIDDLE = np.array([0.0, 0.0, 0.15])
"""Joints at which gains have no effect, rad and m (assumed: an error there is attributed to the base's pose)."""
GAIN_SD = 0.25 * np.array([[0.021, 0.005, 0.065], [0.004, 0.013, 0.033], [0.0019, 0.0012, 0.0105]])
"""Error of q1 q2 q3 (rows) per rad of q1, rad of q2 and m of q3: a quarter of the RMS over six recordings.

Most of the recorded gain stems from the registration used for measuring: with all of it, a rigid fit would leave three
times what the recorded registration sets leave (``benchmarks/bench_cell.py``)."""
PLAY = np.array([[0.0005], [0.0005], [0.0003]])
"""Half-width of their own play, rad and m: a model with this play halves the error of q3 in recordings."""
FIELD_SD = np.array([0.0009, 0.0012, 0.00012])
"""SD of the errors that are neither gain nor play, rad and m."""
SCALE = np.array([0.3, 0.3, 0.05])
RADII = np.array([[0.05, 0.15], [0.05, 0.15], [0.008, 0.025]])
"""Radii of the field: with these, residuals in the cell correlate along the path as in recordings."""


class OuterState(NamedTuple):
    """Operators of the joints' own play (3, 1), and those of the field."""

    play: NDArray[np.float64]
    field: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OuterErrors:
    """Gains, play and a field of errors of one session.

    Attributes:
        gains: (3, 3) error per command.
        play: (3, 1) half-width of each joint's play.
        field: the rest.
    """

    gains: NDArray[np.float64]
    play: NDArray[np.float64]
    field: HistoryField

    @staticmethod
    def drawn(rng: np.random.Generator, scale: float) -> OuterErrors:
        """Return the errors of a session, as a multiple of what recordings show."""
        field = HistoryField.drawn(rng, scale * FIELD_SD, SCALE, RADII)
        return OuterErrors(scale * GAIN_SD * rng.standard_normal((3, 3)), scale * PLAY, field)

    def start(self, q: NDArray[np.float64], rng: np.random.Generator) -> OuterState:
        """Return the state at a command (3,) with unknown slack."""
        return OuterState(q[:, None] + rng.uniform(-1.0, 1.0, (3, 1)) * self.play, self.field.start(q, rng))

    def step(self, memory: OuterState, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], OuterState]:
        """Return the error (3,) at a command (3,), and the new state."""
        followed = np.minimum(np.maximum(memory.play, q[:, None] - self.play), q[:, None] + self.play)
        rest, operators = self.field.step(memory.field, q)
        return self.gains @ (q - MIDDLE) + (followed[:, 0] - q) + rest, OuterState(followed, operators)
