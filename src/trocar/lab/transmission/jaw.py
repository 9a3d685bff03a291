"""The cable of an instrument's jaws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class JawCable:
    """Jaws with a constant offset that follow with play.

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
        """Return the angle to which a command pulls the jaws, and the output of the play."""
        followed = min(max(followed_rad, jaw_rad - self.play_rad), jaw_rad + self.play_rad)
        return followed + self.offset_rad, followed
