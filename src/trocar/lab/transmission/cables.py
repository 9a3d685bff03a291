"""Identified cables, as they are in one session."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.plant import WRIST, CablePlant, PlayState
from trocar.checks import require_numbers
from trocar.lab.flaws import FLAWS, MILD, Difficulty
from trocar.lab.transmission.history_field import HistoryField
from trocar.lab.transmission.outer import OuterErrors, OuterState

OUTER_SHARE = float(np.sqrt(0.5))
"""Share of the outer joints' SD between two equal runs that comes from the joints; the rest is fiducial noise
(assumed)."""
MOST_SHARE = 0.9
"""At most this share of the SD between two equal runs comes from the joints; the rest is fiducial noise."""
MOST_SDS = 2.0
"""No radius, gain or coupling differs by more SDs: an instrument with more wear would be discarded (assumed)."""
SCALE = np.array([1.5, 1.5, 1.5])
RADII = np.tile([0.2, 0.5], (3, 1))
"""Radii of the residual field, rad: with these, residuals in the cell correlate along the path as in recordings."""


class CableState(NamedTuple):
    """Everything that the joints depend on besides the command."""

    play: PlayState
    residual: NDArray[np.float64] | None
    outer: OuterState | None


@dataclass(frozen=True, eq=False)
class Cables:
    """Play, coupling and offset of identified cables, and an error outside the model.

    Attributes:
        plant: the identified instrument, or its state in a session.
        usual: the plant about which sessions scatter if the instrument changes between them (the flaw ``wear``): the
            mean of the recorded ones. A single session may be unusual: with sessions about `psm1_grey_random`, tips
            miss recorded places by 4.6 mm, whereas they really missed them by 3.7 (``benchmarks/bench_cell.py``). None:
            the plant.
        noise_sd: (3,) SD of the wrist's error that differs from run to run, rad.
        wander_sd: (3,) SD of the wrist's offsets over minutes, rad.
        residual: error of the wrist that fits no model's family.
        outer: errors of q1 q2 q3.
    """

    plant: CablePlant
    usual: CablePlant | None = None
    noise_sd: NDArray[np.float64] = field(default_factory=lambda: FLAWS["noise"].values(MILD))
    wander_sd: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    residual: HistoryField | None = None
    outer: OuterErrors | None = None

    def __post_init__(self) -> None:
        require_numbers(self)

    @property
    def source(self) -> str:
        """Return the source of the numbers."""
        return self.plant.source

    @property
    def flaws(self) -> tuple[str, ...]:
        """Return the names of the flaws that have an effect: those of cables."""
        return ("offsets", "wear", "residual", "noise", "creep", "outer")

    @property
    def unrepeatable_sd(self) -> NDArray[np.float64]:
        """Return the part of the SD between two equal runs that comes from the joints."""
        return np.concatenate([self.plant.noise_sd[:3] * OUTER_SHARE, self.noise_sd])

    @property
    def creep_sd(self) -> NDArray[np.float64]:
        """Return the SD of the offsets over minutes."""
        return np.concatenate([np.zeros(3), self.wander_sd])

    @property
    def measurement_sd(self) -> NDArray[np.float64]:
        """Return the part of the SD between two equal runs that comes from the fiducials."""
        share = np.minimum(self.unrepeatable_sd / self.plant.noise_sd, MOST_SHARE)
        return self.plant.noise_sd * np.sqrt(1.0 - share**2)

    def drawn(self, rng: np.random.Generator, difficulty: Difficulty) -> Cables:
        """Return the cables of another session."""
        middle = self.usual if self.usual is not None and difficulty["wear"].any() else self.plant
        offset = middle.offset + difficulty["offsets"] * rng.standard_normal(3)
        worn_rng, residual_rng, outer_rng = rng.spawn(3)
        residual = difficulty["residual"]
        return replace(
            self,
            plant=_worn(middle.with_offset(offset), difficulty["wear"], worn_rng),
            noise_sd=difficulty["noise"],
            wander_sd=difficulty["creep"],
            residual=HistoryField.drawn(residual_rng, residual, SCALE, RADII) if residual.any() else None,
            outer=OuterErrors.drawn(outer_rng, difficulty.scale("outer")) if difficulty["outer"].any() else None,
        )

    def start(self, q_cmd: NDArray[np.float64], rng: np.random.Generator) -> CableState:
        """Return play operators somewhere in their slack."""
        slack = rng.uniform(-1.0, 1.0, 3) * self.plant.radii
        play = tuple((np.array(self.plant.start(q_cmd)) + slack).tolist())
        residual = None if self.residual is None else self.residual.start(q_cmd[WRIST], rng)
        outer = None if self.outer is None else self.outer.start(q_cmd[:3], rng)
        return CableState(play, residual, outer)

    def step(self, memory: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], CableState]:
        """Return the joints (6,) after the command, and the operators."""
        q, play = self.plant.step(memory.play, q_cmd)
        residual, outer = memory.residual, memory.outer
        if self.residual is not None:
            error, residual = self.residual.step(residual, q_cmd[WRIST])
            q[WRIST] += error
        if self.outer is not None:
            error, outer = self.outer.step(outer, q_cmd[:3])
            q[:3] += error
        return q, CableState(play, residual, outer)


def _worn(plant: CablePlant, sd: NDArray[np.float64], rng: np.random.Generator) -> CablePlant:
    """Return the cables with other play, shares, gains and couplings, of these SDs (4,)."""
    if not sd.any():
        return plant
    of_radii, of_shares, of_K, of_C = sd

    def change(size: float, *shape: int) -> NDArray[np.float64]:
        return size * np.clip(rng.standard_normal(shape), -MOST_SDS, MOST_SDS)

    radii = plant.radii * np.exp(change(of_radii, 3))
    a, b = np.array([plant.a, plant.b]) + change(of_shares, 2)
    K, C = plant.K + change(of_K, 3, 3), plant.C + change(of_C, 3, 3)
    return replace(plant, radii=radii, a=float(a), b=float(b), K=K, C=C)
