"""What lies between an encoder and its joint: identified cables, or a field of errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.plant import PLANTS, CablePlant
from trocar.geometry import TURN
from trocar.registry import Registry

UNREPEATABLE_SHARE = float(np.sqrt(0.5))
"""Share of the SD between two equal runs that the joints themselves do; the rest is the fiducials' (assumed equal)."""

CORRELATION_TIME_S = 1.0
"""Time over which the unrepeatable part of the joints' error fades (assumed; the recordings sample each .8 s)."""


class Transmission(Protocol):
    """What an instrument's drive does to the joints, as it is drawn anew for every session."""

    @property
    def source(self) -> str:
        """Return where its numbers come from."""
        ...

    @property
    def unrepeatable_sd(self) -> NDArray[np.float64]:
        """Return the SD (6,) of the joints' error that no model repeats, rad and m."""
        ...

    @property
    def measurement_sd(self) -> NDArray[np.float64]:
        """Return the SD (6,) of one measurement of the joints by fiducials, rad and m."""
        ...

    def drawn(self, rng: np.random.Generator) -> Self:
        """Return the same instrument in another session."""
        ...

    def start(self, q_cmd: NDArray[np.float64], rng: np.random.Generator) -> Any:
        """Return the memory of an arm that rests at this command (6,), its slack unknown."""
        ...

    def step(self, memory: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], Any]:
        """Return the joints (6,) after the command (6,), without what no model repeats, and the new memory."""
        ...


class DriveTrain:
    """One arm's transmission at work: its repeatable part, plus a slow error that does not repeat.

    The unrepeatable part is a smooth random process (an Ornstein-Uhlenbeck process through a low pass of the same
    time). Hysteresis does not depend on speed: the recordings are quasi-static.
    """

    def __init__(self, transmission: Transmission, q_start: NDArray[np.float64], rng: np.random.Generator):
        self.transmission = transmission
        self._memory = transmission.start(q_start, rng)
        self._rng = rng
        self._sd = transmission.unrepeatable_sd
        self._push = np.sqrt(2.0) * self._sd * rng.standard_normal(6)
        self._drift = self._sd * rng.standard_normal(6)

    def advance(self, dt_s: float) -> None:
        """Let the unrepeatable part wander for ``dt_s``."""
        keep = np.exp(-dt_s / CORRELATION_TIME_S)
        kick = self._sd * np.sqrt(2.0 * (1.0 - keep * keep))
        self._push = keep * self._push + kick * self._rng.standard_normal(6)
        self._drift += (self._push - self._drift) * (1.0 - keep)

    def joints(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the joints (6,) are held after the command (6,); call it along the path."""
        q, self._memory = self.transmission.step(self._memory, q_cmd)
        return q + self._drift


@dataclass(frozen=True, eq=False)
class Cables:
    """Play, coupling and offset of identified cables; between sessions the offsets change.

    Attributes:
        plant: the identified instrument.
        drift_sd_rad: SD of the change of the offsets of q4 q5 q6 from session to session (facts/peg_transfer.md: up to
            .07 and .02-.1 rad).
    """

    plant: CablePlant
    drift_sd_rad: tuple[float, float, float] = (0.03, 0.04, 0.04)

    @property
    def source(self) -> str:
        """Return where the numbers come from."""
        return self.plant.source

    @property
    def unrepeatable_sd(self) -> NDArray[np.float64]:
        """Return the joints' share of the SD between two equal runs."""
        return self.plant.noise_sd * UNREPEATABLE_SHARE

    @property
    def measurement_sd(self) -> NDArray[np.float64]:
        """Return the fiducials' share of the SD between two equal runs."""
        return self.plant.noise_sd * np.sqrt(1.0 - UNREPEATABLE_SHARE**2)

    def drawn(self, rng: np.random.Generator) -> Cables:
        """Return the cables with the offsets of another session."""
        change = np.array(self.drift_sd_rad) * rng.standard_normal(3)
        return replace(self, plant=self.plant.with_offset(self.plant.offset + change))

    def start(self, q_cmd: NDArray[np.float64], rng: np.random.Generator) -> Any:
        """Return play operators somewhere in their slack."""
        slack = rng.uniform(-1.0, 1.0, 3) * self.plant.radii
        return tuple((np.array(self.plant.start(q_cmd)) + slack).tolist())

    def step(self, memory: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], Any]:
        """Return the joints (6,) after the command, and the operators."""
        return self.plant.step(memory, q_cmd)


@dataclass(frozen=True, eq=False)
class PoseErrorField:
    """Joints that are off by a constant of the session and by a smooth field over the joints' space, with some play.

    ``q_joint = q_cmd + bias + sum_k a_k sin(w_k q_cmd + p_k) + slack``: a cable-driven arm whose encoders sit at the
    motors. The default sizes give tips that are off as measured on a Raven II: 38 mm and 24.5 deg on average, 7.1 mm
    RMS after the best rigid fit (facts/debridement.md, Real data). How they share among the joints is assumed: most of
    the measured bias is along the vertical, and so along the insertion of an instrument that works downwards. Tested
    in ``tests/station/test_transmission.py``.

    Attributes:
        bias_sd: (6,) of the constant, rad and m, drawn in each session.
        field_sd: (6,) of the smooth part, likewise.
        play: (6,) half-width of each joint's play, rad and m (assumed).
        noise_sd: (6,) of what does not repeat (assumed).
        scale: (6,) distance in each joint's command over which the field changes, rad and m (assumed).
        bias: (6,) of this session.
        waves: (k, 6) wave vectors of this session's field.
        phases: (k,) likewise.
        amplitudes: (k, 6) likewise.
    """

    bias_sd: tuple[float, ...] = (0.103, 0.103, 0.039, 0.29, 0.245, 0.245)
    field_sd: tuple[float, ...] = (0.040, 0.040, 0.0070, 0.09, 0.08, 0.08)
    play: tuple[float, ...] = (0.004, 0.004, 0.0005, 0.02, 0.02, 0.02)
    noise_sd: tuple[float, ...] = (0.001, 0.001, 0.0002, 0.005, 0.008, 0.008)
    scale: tuple[float, ...] = (0.25, 0.25, 0.06, 0.8, 0.8, 0.8)
    bias: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    waves: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 6)))
    phases: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    amplitudes: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 6)))

    WAVES = 24
    MOST_SDS = 1.5
    """An arm that is further off on some axis is homed again (assumed)."""

    @property
    def source(self) -> str:
        """Return where the numbers come from."""
        return "pose errors of a Raven II, gripper_pose_pairs (38 mm and 24.5 deg raw, 7 mm RMS after a rigid fit)"

    @property
    def unrepeatable_sd(self) -> NDArray[np.float64]:
        """Return the SD of what does not repeat."""
        return np.array(self.noise_sd)

    @property
    def measurement_sd(self) -> NDArray[np.float64]:
        """Return the SD of one measurement by fiducials, taken to be as large as what does not repeat."""
        return np.array(self.noise_sd)

    def drawn(self, rng: np.random.Generator) -> PoseErrorField:
        """Return another session: another constant, another field."""
        count = self.WAVES
        return replace(
            self,
            bias=np.array(self.bias_sd) * np.clip(rng.standard_normal(6), -self.MOST_SDS, self.MOST_SDS),
            waves=rng.standard_normal((count, 6)) / np.array(self.scale),
            phases=rng.uniform(0.0, TURN, count),
            amplitudes=np.array(self.field_sd) * np.sqrt(2.0 / count) * rng.standard_normal((count, 6)),
        )

    def start(self, q_cmd: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return play operators (6,) somewhere in their slack."""
        return q_cmd + rng.uniform(-1.0, 1.0, 6) * np.array(self.play)

    def step(
        self, memory: NDArray[np.float64], q_cmd: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joints (6,) after the command, and the operators."""
        r = np.array(self.play)
        followed = np.clip(memory, q_cmd - r, q_cmd + r)
        smooth = np.sin(self.waves @ q_cmd + self.phases) @ self.amplitudes
        return followed + self.bias + smooth, followed


STIFF = CablePlant(
    radii=np.zeros(3),
    a=0.0,
    b=0.0,
    offset=np.zeros(3),
    K=np.zeros((3, 3)),
    C=np.zeros((3, 3)),
    noise_sd=np.zeros(6),
    source="joints that follow their encoders exactly",
)

TRANSMISSIONS: Registry[Transmission] = Registry(
    "transmission",
    "trocar.transmissions",
    {name: Cables(plant) for name, plant in PLANTS.items()}
    | {"raven2": PoseErrorField(), "stiff": Cables(STIFF, (0.0, 0.0, 0.0))},
)
"""What a station's arm can have between encoder and joint, by name."""

__all__ = ["TRANSMISSIONS", "Cables", "DriveTrain", "PoseErrorField", "Transmission"]
