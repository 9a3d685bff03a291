"""An error that fits no model's family: a smooth random function of where three joints are and how they got there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import TURN

WAVES = 48


@dataclass(frozen=True, eq=False)
class HistoryField:
    """Errors of three joints: ``sum_k a_k sin(v_k u + w_k s + p_k)`` of commands u and slacks s of play operators.

    The same path through the commands gives the same errors, another path to the same place gives others, and it does
    not matter how fast or how finely the path is sampled: the recordings' residuals behave the same way. No play model
    contains it.

    Attributes:
        radii: (3, m) of the play operators, in the joints' units.
        v: (k, 3) wave vectors over the commands.
        w: (k, 3 m) over the slacks, in shares of their radii.
        phases: (k,).
        amplitudes: (k, 3).
    """

    radii: NDArray[np.float64]
    v: NDArray[np.float64]
    w: NDArray[np.float64]
    phases: NDArray[np.float64]
    amplitudes: NDArray[np.float64]

    @staticmethod
    def drawn(
        rng: np.random.Generator, sd: NDArray[np.float64], scale: NDArray[np.float64], radii: NDArray[np.float64]
    ) -> HistoryField:
        """Return a field of errors of this SD (3,).

        Args:
            rng: of the waves.
            sd: of the errors.
            scale: (3,) of each joint: the distance over which errors change if the slacks stay.
            radii: (3, m) of the play operators.
        """
        v = rng.standard_normal((WAVES, 3)) / scale
        w = rng.standard_normal((WAVES, radii.size))
        amplitudes = sd * np.sqrt(2.0 / WAVES) * rng.standard_normal((WAVES, 3))
        return HistoryField(radii, v, w, rng.uniform(0.0, TURN, WAVES), amplitudes)

    def start(self, u: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return play operators (3, m) somewhere in their slack."""
        return u[:, None] + rng.uniform(-1.0, 1.0, self.radii.shape) * self.radii

    def step(
        self, memory: NDArray[np.float64], u: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the errors (3,) at a command (3,), and the operators."""
        column = u[:, None]
        followed = np.minimum(np.maximum(memory, column - self.radii), column + self.radii)
        slacks = ((column - followed) / self.radii).ravel()
        return np.sin(self.v @ u + self.w @ slacks + self.phases) @ self.amplitudes, followed
