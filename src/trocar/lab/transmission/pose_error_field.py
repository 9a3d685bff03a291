"""The transmission of an arm whose encoders sit at its motors: joints with a smooth field of errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from trocar.checks import require_numbers
from trocar.geometry import TURN
from trocar.geometry.arrays import Array
from trocar.lab.flaws import Difficulty
from trocar.lab.transmission.base import Transmission


@dataclass(frozen=True, eq=False)
class PoseErrorField(Transmission):
    """Joints that are off by a constant of the session and by a smooth field over joint space, with some play.

    ``q_joint = P(q_cmd) + bias + sum_k a_k sin(w_k q_cmd + p_k)`` with a play operator P for each joint: a cable-driven
    arm whose encoders sit at the motors. The default sizes give tip errors as measured on a Raven II: 38 mm and
    24.5 deg on average, 7.1 mm RMS after the best rigid fit. How they are distributed over the joints is assumed: most
    of the measured bias is along the vertical, and so along the insertion of an instrument that works downwards. Only
    one session was recorded, so it is unknown how sizes vary. The constant has the same size in every session, both in
    the outer joints and in the wrist, but a random direction in either space (assumed).

    Attributes:
        bias_rms: (6,) RMS of the constant, rad and m.
        field_sd: (6,) SD of the smooth field, rad and m.
        play: (6,) half-width of each joint's play, rad and m (assumed).
        noise_sd: (6,) SD of the unrepeatable error, rad and m (assumed).
        scale: (6,) distance in each joint's command over which the field changes, rad and m (assumed).
        bias: (6,) constant of this session.
        waves: (k, 6) wave vectors of this session's field.
        phases: (k,) phases of this session's field.
        amplitudes: (k, 6) amplitudes of this session's field.
    """

    bias_rms: tuple[float, ...] = (0.087, 0.087, 0.033, 0.256, 0.215, 0.215)
    field_sd: tuple[float, ...] = (0.040, 0.040, 0.0070, 0.09, 0.08, 0.08)
    play: tuple[float, ...] = (0.004, 0.004, 0.0005, 0.02, 0.02, 0.02)
    noise_sd: tuple[float, ...] = (0.001, 0.001, 0.0002, 0.005, 0.008, 0.008)
    scale: tuple[float, ...] = (0.25, 0.25, 0.06, 0.8, 0.8, 0.8)
    bias: Array = field(default_factory=lambda: np.zeros(6))
    waves: Array = field(default_factory=lambda: np.zeros((0, 6)))
    phases: Array = field(default_factory=lambda: np.zeros(0))
    amplitudes: Array = field(default_factory=lambda: np.zeros((0, 6)))

    WAVES: ClassVar[int] = 24

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def source(self) -> str:
        """Return the source of the numbers."""
        return "pose errors of a Raven II, gripper_pose_pairs (38 mm and 24.5 deg raw, 7 mm RMS after a rigid fit)"

    @property
    def flaws(self) -> tuple[str, ...]:
        """Return the names of the flaws that have an effect."""
        return ("kinematics",)

    @property
    def unrepeatable_sd(self) -> Array:
        """Return the SD of the part that does not repeat."""
        return np.array(self.noise_sd)

    @property
    def measurement_sd(self) -> Array:
        """Return the SD of one measurement by fiducials, assumed to be as large as the unrepeatable part."""
        return np.array(self.noise_sd)

    def drawn(self, rng: np.random.Generator, difficulty: Difficulty) -> PoseErrorField:
        """Return another session, with another constant and another field."""
        count, scale = self.WAVES, difficulty.scale("kinematics")
        return replace(
            self,
            bias=scale * np.array(self.bias_rms) * np.concatenate([_direction(rng), _direction(rng)]),
            waves=rng.standard_normal((count, 6)) / np.array(self.scale),
            phases=rng.uniform(0.0, TURN, count),
            amplitudes=scale * np.array(self.field_sd) * np.sqrt(2.0 / count) * rng.standard_normal((count, 6)),
        )

    def start(self, q_cmd: Array, rng: np.random.Generator) -> Array:
        """Return the play operators (6,) with random slacks."""
        return q_cmd + rng.uniform(-1.0, 1.0, 6) * np.array(self.play)

    def step(self, memory: Array, q_cmd: Array) -> tuple[Array, Array]:
        """Return the joints (6,) after the command (6,), and the new operators."""
        r = np.array(self.play)
        followed = np.minimum(np.maximum(memory, q_cmd - r), q_cmd + r)
        smooth = np.sin(self.waves @ q_cmd + self.phases) @ self.amplitudes
        return followed + self.bias + smooth, followed


def _direction(rng: np.random.Generator) -> Array:
    """Return three numbers with a mean square of 1, in a random direction."""
    shares = rng.standard_normal(3)
    return np.sqrt(3.0) * shares / np.linalg.norm(shares)
