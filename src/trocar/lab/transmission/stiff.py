"""Joints that follow their encoders exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.lab.flaws import Difficulty


@dataclass(frozen=True)
class Stiff:
    """No cables at all; the same in every session and at every difficulty."""

    @property
    def source(self) -> str:
        """Return what it is."""
        return "joints that follow their encoders exactly"

    @property
    def flaws(self) -> tuple[str, ...]:
        """Return the names of the flaws that have an effect: none."""
        return ()

    @property
    def unrepeatable_sd(self) -> NDArray[np.float64]:
        """Return zeros: everything repeats."""
        return np.zeros(6)

    @property
    def creep_sd(self) -> NDArray[np.float64]:
        """Return zeros: nothing wanders."""
        return np.zeros(6)

    @property
    def measurement_sd(self) -> NDArray[np.float64]:
        """Return zeros: the joints are measured exactly."""
        return np.zeros(6)

    def drawn(self, rng: np.random.Generator, difficulty: Difficulty) -> Stiff:
        """Return itself: sessions do not differ."""
        del rng, difficulty
        return self

    def start(self, q_cmd: NDArray[np.float64], rng: np.random.Generator) -> None:
        """Return None: it has no state."""
        del q_cmd, rng

    def step(self, memory: None, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], None]:
        """Return the joints (6,): the command."""
        return q_cmd.copy(), memory
