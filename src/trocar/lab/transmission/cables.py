"""Identified cables as they are in one session, with errors that no cable model contains."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from trocar.calibration.plant import WRIST, CablePlant, PlayState
from trocar.checks import require_numbers
from trocar.geometry import TURN
from trocar.geometry.arrays import Array
from trocar.lab.flaws import FLAWS, MILD, Difficulty
from trocar.lab.transmission.base import Transmission

WAVES = 48


@dataclass(frozen=True, eq=False)
class HistoryField:
    """Errors of three joints: ``sum_k a_k sin(v_k u + w_k s + p_k)`` of commands u and slacks s of play operators.

    The errors depend on the path of the commands, not on its speed or sampling: the same path gives the same errors,
    another path to the same place gives others. The recordings' residuals behave the same way. No play model contains
    such a field.

    Attributes:
        radii: (3, m) radii of the play operators, in the joints' units.
        v: (k, 3) wave vectors over the commands.
        w: (k, 3 m) wave vectors over the slacks, in shares of their radii.
        phases: (k,) phases of the waves.
        amplitudes: (k, 3) amplitudes of the waves for each joint.
    """

    radii: Array
    v: Array
    w: Array
    phases: Array
    amplitudes: Array

    @staticmethod
    def drawn(rng: np.random.Generator, sd: Array, scale: Array, radii: Array) -> HistoryField:
        """Return a field of errors with this SD (3,), which change over commands of ``scale`` (3,) at fixed slacks."""
        v = rng.standard_normal((WAVES, 3)) / scale
        w = rng.standard_normal((WAVES, radii.size))
        amplitudes = sd * np.sqrt(2.0 / WAVES) * rng.standard_normal((WAVES, 3))
        return HistoryField(radii, v, w, rng.uniform(0.0, TURN, WAVES), amplitudes)

    def start(self, u: Array, rng: np.random.Generator) -> Array:
        """Return the play operators (3, m) with random slacks."""
        return u[:, None] + rng.uniform(-1.0, 1.0, self.radii.shape) * self.radii

    def step(self, memory: Array, u: Array) -> tuple[Array, Array]:
        """Return the errors (3,) at a command (3,), and the new operators."""
        column = u[:, None]
        followed = np.minimum(np.maximum(memory, column - self.radii), column + self.radii)
        slacks = (column - followed) / self.radii
        waves = self.v.dot(u)  # for arrays this small, dot takes half the time of @
        waves += self.w.dot(slacks.ravel())
        waves += self.phases
        return np.sin(waves).dot(self.amplitudes), followed


MIDDLE = np.array([0.0, 0.0, 0.15])
"""Joints at which gains have no effect, rad and m (assumed: an error there counts as one of the base's pose)."""
GAIN_SD = 0.25 * np.array([[0.021, 0.005, 0.065], [0.004, 0.013, 0.033], [0.0019, 0.0012, 0.0105]])
"""Error of q1 q2 q3 (rows) per rad of q1, rad of q2 and m of q3: a quarter of the RMS over six recordings.

Most of the recorded gain stems from the registration behind the measurements: with all of it, a rigid fit would leave
three times the residual of the recorded registration sets (``benchmarks/bench_cell.py``)."""
PLAY = np.array([[0.0005], [0.0005], [0.0003]])
"""Half-width of the outer joints' play, rad and m: a model with this play halves the error of q3 in recordings."""
FIELD_SD = np.array([0.0009, 0.0012, 0.00012])
"""SD of the errors that are neither gain nor play, rad and m."""
OUTER_SCALE = np.array([0.3, 0.3, 0.05])
OUTER_RADII = np.array([[0.05, 0.15], [0.05, 0.15], [0.008, 0.025]])
"""Radii of the field: with these, residuals in the cell correlate along the path as in recordings."""


class OuterState(NamedTuple):
    """Play operators of the joints (3, 1) and of the field (3, m)."""

    play: Array
    field: Array


@dataclass(frozen=True, eq=False)
class OuterErrors:
    """Errors of the outer joints q1 q2 q3 in one session: gains, play and a field.

    Attributes:
        gains: (3, 3) error per command.
        play: (3, 1) half-width of each joint's play.
        field: the remaining errors.
    """

    gains: Array
    play: Array
    field: HistoryField

    @staticmethod
    def drawn(rng: np.random.Generator, scale: float) -> OuterErrors:
        """Return the errors of a session, scaled to a multiple of the recorded ones."""
        field = HistoryField.drawn(rng, scale * FIELD_SD, OUTER_SCALE, OUTER_RADII)
        return OuterErrors(scale * GAIN_SD * rng.standard_normal((3, 3)), scale * PLAY, field)

    def start(self, q: Array, rng: np.random.Generator) -> OuterState:
        """Return the state at a command (3,) with unknown slack."""
        return OuterState(q[:, None] + rng.uniform(-1.0, 1.0, (3, 1)) * self.play, self.field.start(q, rng))

    def step(self, memory: OuterState, q: Array) -> tuple[Array, OuterState]:
        """Return the error (3,) at a command (3,), and the new state."""
        followed = np.minimum(np.maximum(memory.play, q[:, None] - self.play), q[:, None] + self.play)
        rest, operators = self.field.step(memory.field, q)
        return self.gains @ (q - MIDDLE) + (followed[:, 0] - q) + rest, OuterState(followed, operators)


OUTER_SHARE = float(np.sqrt(0.5))
"""Share of the outer joints' SD between two equal runs that comes from the joints; the rest is fiducial noise
(assumed)."""
MOST_SHARE = 0.9
"""At most this share of the SD between two equal runs comes from the joints; the rest is fiducial noise."""
MOST_SDS = 2.0
"""Changes of radii, gains and couplings are clipped at this many SDs: a more worn tool would be discarded (assumed)."""
SCALE = np.array([1.5, 1.5, 1.5])
RADII = np.tile([0.2, 0.5], (3, 1))
"""Radii of the residual field, rad: with these, residuals in the cell correlate along the path as in recordings."""


class CableState(NamedTuple):
    """The state on which the joints depend, besides the command."""

    play: PlayState
    residual: Array | None
    outer: OuterState | None


@dataclass(frozen=True, eq=False)
class Cables(Transmission):
    """Play, coupling and offset of identified cables, and errors outside their model.

    Attributes:
        plant: the identified instrument, or its state in a session.
        usual: the plant about which sessions scatter if the instrument wears between them (the flaw ``wear``): the mean
            of the recorded sessions; None: ``plant``. A single session may be unusual: with sessions about
            `psm1_grey_random`, tips miss recorded places by 4.6 mm, but the real ones missed them by 3.7 mm
            (``benchmarks/bench_cell.py``).
        noise_sd: (3,) SD of the wrist's error that differs from run to run, rad.
        wander_sd: (3,) SD of the wrist's offsets over minutes, rad.
        residual: errors of the wrist that no cable model can fit.
        outer: errors of q1 q2 q3.
    """

    plant: CablePlant
    usual: CablePlant | None = None
    noise_sd: Array = field(default_factory=lambda: FLAWS["noise"].values(MILD))
    wander_sd: Array = field(default_factory=lambda: np.zeros(3))
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
        """Return the names of the flaws that have an effect."""
        return ("offsets", "wear", "residual", "noise", "creep", "outer")

    @property
    def unrepeatable_sd(self) -> Array:
        """Return the part of the SD between two equal runs that comes from the joints."""
        return np.concatenate([self.plant.noise_sd[:3] * OUTER_SHARE, self.noise_sd])

    @property
    def creep_sd(self) -> Array:
        """Return the SD of the offsets over minutes."""
        return np.concatenate([np.zeros(3), self.wander_sd])

    @property
    def measurement_sd(self) -> Array:
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

    def start(self, q_cmd: Array, rng: np.random.Generator) -> CableState:
        """Return the state with random slacks."""
        slack = rng.uniform(-1.0, 1.0, 3) * self.plant.radii
        play = tuple((np.array(self.plant.start(q_cmd)) + slack).tolist())
        residual = None if self.residual is None else self.residual.start(q_cmd[WRIST], rng)
        outer = None if self.outer is None else self.outer.start(q_cmd[:3], rng)
        return CableState(play, residual, outer)

    def step(self, memory: Any, q_cmd: Array) -> tuple[Array, CableState]:
        """Return the joints (6,) after the command (6,), and the new state."""
        q, play = self.plant.step(memory.play, q_cmd)
        residual, outer = memory.residual, memory.outer
        if self.residual is not None:
            error, residual = self.residual.step(residual, q_cmd[WRIST])
            q[WRIST] += error
        if self.outer is not None:
            error, outer = self.outer.step(outer, q_cmd[:3])
            q[:3] += error
        return q, CableState(play, residual, outer)


def _worn(plant: CablePlant, sd: Array, rng: np.random.Generator) -> CablePlant:
    """Return the cables with changes of these SDs (4,): logarithms of radii, shares a and b, K, C."""
    if not sd.any():
        return plant
    of_radii, of_shares, of_K, of_C = sd

    def change(size: float, *shape: int) -> Array:
        return size * np.clip(rng.standard_normal(shape), -MOST_SDS, MOST_SDS)

    radii = plant.radii * np.exp(change(of_radii, 3))
    a, b = np.array([plant.a, plant.b]) + change(of_shares, 2)
    K, C = plant.K + change(of_K, 3, 3), plant.C + change(of_C, 3, 3)
    return replace(plant, radii=radii, a=float(a), b=float(b), K=K, C=C)
