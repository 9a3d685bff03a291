"""The interface of cable models, and what their implementations share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.calibration.recording import Recording
from trocar.checks import require_numbers
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite

MAX_VALUE = 1e6  # numbers of a cable model are not larger than this: features are standardised, angles in rad
MIN_ROWS = 30  # fewer valid rows than this do not identify a model's offsets, let alone its hysteresis
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class TrainingMotion:
    """Statistics of the motion that a model was fitted on, in joint space."""

    interval: Array  # (6,) mean step |dq| between samples, rad and m (q3), to which paths are resampled
    lower: Array  # (6,) smallest command
    upper: Array  # (6,) largest command
    rows: int  # number of valid rows used

    def __post_init__(self) -> None:
        require_numbers(self)

    def __repr__(self) -> str:
        ends = zip(np.degrees(self.lower[3:]), np.degrees(self.upper[3:]), strict=True)
        ranges = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends)
        return f"<TrainingMotion of {self.rows} rows: q4 q5 q6 from {ranges} deg>"

    @staticmethod
    def of(recording: Recording) -> TrainingMotion:
        """Return the statistics of a recording; raises InvalidInput if it is too short for a fit."""
        rows = int(recording.valid.sum())
        if rows < MIN_ROWS:
            why = f" ({reasons})" if (reasons := recording.why_invalid()) else ""
            problem = f"has {rows} valid rows of {len(recording)}{why}"
            raise InvalidInput(recording.name, problem, f"a fit needs {MIN_ROWS} or more")
        q = recording.q_cmd[: int(np.flatnonzero(recording.valid)[-1]) + 1]
        return TrainingMotion(sampling_interval(q), q.min(axis=0), q.max(axis=0), rows)


class CableModel(Protocol):
    """A forward model of the cables: joints from the history of commands.

    ``step`` is pure: it returns the joints and a new state without changing the old one, so that a controller can try
    several commands from one state. For a sequence that starts at rest, ``predict`` returns the same joints as
    ``start`` at the first command followed by a ``step`` for each command.
    """

    name: ClassVar[str]
    """Name on the command line and in files."""
    rate_independent: ClassVar[bool]
    """Whether the joints depend only on the path of the commands, however densely it is sampled."""

    @property
    def training(self) -> TrainingMotion:
        """The motion that the model was fitted on."""
        ...

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model fitted on the valid rows; all commands enter its memory."""
        ...

    def predict(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) for a whole history of commands (n, 6)."""
        ...

    def start(self, q_cmd: Array) -> Any:
        """Return the state of an arm that has been at rest at this command (6,)."""
        ...

    def step(self, state: Any, q_cmd: Array) -> tuple[Array, Any]:
        """Return the joints (6,) after the command (6,), and the new state."""
        ...

    def shifted(self, offset: Array) -> Self:
        """Return the model with this offset (6,) added to all predictions: the same cables in another session."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that :meth:`from_arrays` needs, apart from the training motion."""
        ...

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model that :meth:`arrays` described; raises InvalidInput if they are damaged (:func:`shaped`)."""
        ...


@runtime_checkable
class Invertible(Protocol):
    """A cable model that also provides the wrist's Jacobian, so that commands are found exactly, not by Algorithm 1."""

    def linearize(self, state: Any, q_cmd: Array) -> tuple[Array, Array]:
        """Return the joints (6,) after the command (6,), and the wrist's d q_joint / d q_cmd (3, 3)."""
        ...


class WithOffset:
    """A cable model, a dataclass, whose predictions contain an offset."""

    offset: Array  # (6,) rad and m (q3)

    def shifted(self, offset: Array) -> Self:
        """Return the model with this offset (6,) added to its predictions."""
        return replace(self, offset=self.offset + offset)  # type: ignore[type-var]


def in_words(model: CableModel, more: str = "") -> str:
    """Return a model in one line, for its ``repr``: name, how much it was fitted on, and other details."""
    return f"<cable model {model.name!r}, fitted on {model.training.rows} rows{f': {more}' if more else ''}>"


def commands(q_cmd: ArrayLike) -> Array:
    """Return a history of commands as float64 (n, 6), one row of q1 to q6 per sample; raises InvalidInput."""
    return finite("commands q1 to q6", q_cmd, "n", 6)


def sampling_interval(q: Array) -> Array:
    """Return the mean step |dq| (6,) between the samples of a motion (n, 6), ignoring pauses."""
    steps = np.abs(np.diff(q, axis=0))
    moving = steps[steps.max(axis=1, initial=0.0) > 1e-9]
    return moving.mean(axis=0) if len(moving) else np.zeros(q.shape[1])


def shaped(arrays: Arrays, **shapes: tuple[int | str, ...]) -> dict[str, NDArray[Any]]:
    """Return arrays of a file after checking them.

    >>> shaped(arrays, offset=(6,), radii=(3, "k"), linear=(3, "d"))

    A letter in a shape stands for any length, the same in all shapes.

    Raises InvalidInput: an array is missing, has another shape, or holds values that are not finite or absurdly large.
    """
    lengths: dict[str, int] = {}
    found: dict[str, NDArray[Any]] = {}
    for name, shape in shapes.items():
        if name not in arrays:
            raise InvalidInput(f"array {name!r}", "is missing")
        value = arrays[name]
        wanted = tuple(
            lengths.setdefault(n, value.shape[i]) if isinstance(n, str) and i < value.ndim else n
            for i, n in enumerate(shape)
        )
        if value.shape != wanted:
            raise InvalidInput(f"array {name!r}", f"has shape {value.shape}, not {wanted}")
        # a column that never moved has an infinite scale, and so no weight
        known = value[value != np.inf] if name.endswith("scale") else value
        if value.dtype.kind not in "biuf" or not np.isfinite(known).all() or np.abs(known).max(initial=0.0) > MAX_VALUE:
            raise InvalidInput(f"array {name!r}", "holds numbers that no model can have")
        found[name] = value
    return found
