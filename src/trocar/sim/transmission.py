"""What lies between the encoder and the joint: the identified cables, and what no model repeats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.plant import CablePlant

UNREPEATABLE_SHARE = np.sqrt(0.5)
"""Share of the SD between two equal runs that the joints themselves do; the rest is the fiducials' (assumed equal)."""

CORRELATION_TIME_S = 1.0
"""Time over which the unrepeatable part of the joints' error fades (assumed; the recordings sample each .8 s)."""


class Transmission:
    """One arm's cables: play, coupling and offset of a plant, plus a slow unrepeatable error.

    The unrepeatable part is a smooth random process (an Ornstein-Uhlenbeck process through a low pass of the same
    time) with its share of the identified SD. Hysteresis does not depend on speed: the recordings are quasi-static.
    """

    def __init__(
        self,
        plant: CablePlant,
        q_start: NDArray[np.float64],
        rng: np.random.Generator,
        unrepeatable: bool = True,
    ):
        self.plant = plant
        slack = rng.uniform(-1.0, 1.0, 3) * plant.radii
        self._state = tuple((np.array(plant.start(q_start)) + slack).tolist())
        self._rng = rng
        self._sd = plant.noise_sd * UNREPEATABLE_SHARE if unrepeatable else np.zeros(6)
        self._push = np.sqrt(2.0) * self._sd * rng.standard_normal(6)
        self._drift = self._sd * rng.standard_normal(6)

    def advance(self, dt_s: float) -> None:
        """Let the unrepeatable part wander for ``dt_s``."""
        keep = np.exp(-dt_s / CORRELATION_TIME_S)
        kick = self._sd * np.sqrt(2.0 * (1.0 - keep * keep))
        self._push = keep * self._push + kick * self._rng.standard_normal(6)
        self._drift += (self._push - self._drift) * (1.0 - keep)

    def joints(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the cables hold the joints (6,) after the command (6,); call it along the path."""
        q, self._state = self.plant.step(self._state, q_cmd)
        return q + self._drift
