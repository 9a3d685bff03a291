"""The interface of transmissions, a running one with its noise, and the simplest ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from trocar.geometry.arrays import Array
from trocar.lab.flaws import Difficulty

CORRELATION_TIME_S = 1.0
"""Correlation time of the unrepeatable part of the joints' error (assumed; the recordings sample every .8 s)."""

CREEP_TIME_S = 300.0
"""Correlation time of creep (assumed: it is seen after 80 s in recordings of a quarter of an hour)."""


class Transmission(Protocol):
    """The drive between an instrument's encoders and joints, drawn anew for every session.

    By default it has no noise, creep or flaws.
    """

    @property
    def source(self) -> str:
        """Return the source of the numbers."""
        ...

    @property
    def flaws(self) -> tuple[str, ...]:
        """Return the names of the flaws in ``FLAWS`` that have an effect on it."""
        return ()

    @property
    def unrepeatable_sd(self) -> Array:
        """Return the SD (6,) of the joints' error that no model can reproduce, rad and m."""
        return np.zeros(6)

    @property
    def measurement_sd(self) -> Array:
        """Return the SD (6,) of one measurement of the joints by fiducials, rad and m."""
        return np.zeros(6)

    @property
    def creep_sd(self) -> Array:
        """Return the SD (6,) of the part that wanders over minutes, rad and m."""
        return np.zeros(6)

    def drawn(self, rng: np.random.Generator, difficulty: Difficulty) -> Self:
        """Return the same instrument in another session."""
        ...

    def start(self, q_cmd: Array, rng: np.random.Generator) -> Any:
        """Return the state of an arm that rests at this command (6,) with unknown slack."""
        ...

    def step(self, memory: Any, q_cmd: Array) -> tuple[Array, Any]:
        """Return the joints (6,) after the command (6,), without the unrepeatable part, and the new state."""
        ...


class DriveTrain:
    """The running transmission of one arm: its repeatable part, plus errors that do not repeat.

    The latter change within a second (an Ornstein-Uhlenbeck process through a low-pass filter with the same time
    constant) or, for creep, over minutes. Hysteresis does not depend on speed: the recordings are quasi-static.
    """

    def __init__(self, transmission: Transmission, q_start: Array, rng: np.random.Generator):
        self.transmission = transmission
        self._memory = transmission.start(q_start, rng)
        self._rng = rng
        self._sd = transmission.unrepeatable_sd
        self._push = np.sqrt(2.0) * self._sd * rng.standard_normal(6)
        self._drift = self._sd * rng.standard_normal(6)
        self._creep_sd = transmission.creep_sd
        self._creep_rng = rng.spawn(1)[0]
        self._creep = self._creep_sd * self._creep_rng.standard_normal(6)

    def advance(self, dt_s: float) -> None:
        """Advance the unrepeatable part by ``dt_s``."""
        keep = np.exp(-dt_s / CORRELATION_TIME_S)
        kick = self._sd * np.sqrt(2.0 * (1.0 - keep * keep))
        self._push = keep * self._push + kick * self._rng.standard_normal(6)
        self._drift += (self._push - self._drift) * (1.0 - keep)
        if self._creep_sd.any():
            keep = np.exp(-dt_s / CREEP_TIME_S)
            kick = self._creep_sd * np.sqrt(1.0 - keep * keep)
            self._creep = keep * self._creep + kick * self._creep_rng.standard_normal(6)

    def joints(self, q_cmd: Array) -> Array:
        """Return the joints (6,) after the command (6,); call it for each command along the path."""
        q, self._memory = self.transmission.step(self._memory, q_cmd)
        return q + self._drift + self._creep


@dataclass(frozen=True)
class Stiff(Transmission):
    """Joints that follow their encoders exactly, in every session and at every difficulty."""

    @property
    def source(self) -> str:
        """Return a description."""
        return "joints that follow their encoders exactly"

    def drawn(self, rng: np.random.Generator, difficulty: Difficulty) -> Stiff:
        """Return itself: sessions do not differ."""
        del rng, difficulty
        return self

    def start(self, q_cmd: Array, rng: np.random.Generator) -> None:
        """Return None: it has no state."""

    def step(self, memory: None, q_cmd: Array) -> tuple[Array, None]:
        """Return the joints (6,): the command."""
        return q_cmd.copy(), memory


@dataclass(frozen=True)
class JawCable:
    """Jaws that follow their motor with a constant offset and with play.

    Attributes:
        offset_rad: true minus encoder angle, in one session.
        play_rad: half-width of the play.
    """

    offset_rad: float = 0.0
    play_rad: float = 0.0

    @staticmethod
    def drawn(rng: np.random.Generator, size_rad: float) -> JawCable:
        """Return the cable of a session."""
        return JawCable(size_rad * float(rng.standard_normal()), size_rad)

    def step(self, followed_rad: float, jaw_rad: float) -> tuple[float, float]:
        """Return the angle to which a command pulls the jaws, and the new output of the play operator."""
        followed = min(max(followed_rad, jaw_rad - self.play_rad), jaw_rad + self.play_rad)
        return followed + self.offset_rad, followed

    def read(self, jaw_rad: float, commanded_rad: float) -> float:
        """Return what the motor's encoder reads while the fingers are at an angle.

        The motor goes where it is commanded, until the fingers stop it: it is at most the play away from them. So the
        encoder shows what the jaws closed on, but not by how much they open less than commanded.
        """
        without_offset = jaw_rad - self.offset_rad
        return min(max(commanded_rad, without_offset - self.play_rad), without_offset + self.play_rad)
