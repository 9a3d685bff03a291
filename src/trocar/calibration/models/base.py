"""The interface of cable models, and their file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.calibration.recording import Recording, sampling_interval, why_invalid
from trocar.checks import require_numbers
from trocar.errors import TrocarError

MAX_VALUE = 1e6
"""Numbers of a cable model are not larger than this: features are standardised, angles in rad."""

MIN_ROWS = 30
"""Fewer valid rows than this do not identify a model's offsets, let alone its hysteresis."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class TrainingMotion:
    """Statistics of the motion that a model was fitted on, in joint space.

    Attributes:
        interval: (6,) mean step |dq| between samples, rad and m (q3); paths of tasks are resampled to it.
        lower: (6,) smallest command.
        upper: (6,) largest command.
        rows: number of valid rows used.
    """

    interval: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    rows: int

    def __post_init__(self) -> None:
        require_numbers(self)

    def __repr__(self) -> str:
        ends = zip(np.degrees(self.lower[3:]), np.degrees(self.upper[3:]), strict=True)
        ranges = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends)
        return f"<TrainingMotion of {self.rows} rows: q4 q5 q6 from {ranges} deg>"

    @staticmethod
    def of(recording: Recording) -> TrainingMotion:
        """Return the statistics of a recording, or raise TrocarError if it is too short for a fit."""
        rows = int(recording.valid.sum())
        if rows < MIN_ROWS:
            why = f" ({reasons})" if (reasons := why_invalid(recording)) else ""
            raise TrocarError(
                f"{recording.name} has {rows} valid rows of {len(recording)}{why}; a fit needs {MIN_ROWS} or more"
            )
        q = recording.q_cmd[: int(np.flatnonzero(recording.valid)[-1]) + 1]
        return TrainingMotion(sampling_interval(q), q.min(axis=0), q.max(axis=0), rows)


class CableModel(Protocol):
    """A forward model of the cables: joints from the history of commands.

    ``step`` is pure: it returns the joints and a new state without changing the old one, so that a controller can try
    several commands from one state.
    """

    name: ClassVar[str]
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

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) for a whole history of commands (n, 6)."""
        ...

    def start(self, q_cmd: NDArray[np.float64]) -> Any:
        """Return the state of an arm that has been at rest at this command (6,)."""
        ...

    def step(self, state: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], Any]:
        """Return the joints (6,) after the command (6,), and the new state."""
        ...

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model with this offset (6,) added to all predictions: the same cables in another session."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that :meth:`from_arrays` needs, apart from the training motion."""
        ...

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model that :meth:`arrays` described."""
        ...


def in_words(model: CableModel, more: str = "") -> str:
    """Return a model in one line, for its ``repr``: name, how much it was fitted on, and other details."""
    return f"<cable model {model.name!r}, fitted on {model.training.rows} rows{f': {more}' if more else ''}>"


def commands(q_cmd: ArrayLike) -> NDArray[np.float64]:
    """Return a history of commands as float64 (n, 6), or raise TrocarError."""
    q = np.asarray(q_cmd, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != 6:
        raise TrocarError(f"commands have shape {q.shape}; they need (n, 6), one row of q1 to q6 per sample")
    if not np.all(np.isfinite(q)):
        raise TrocarError("commands hold NaN or infinity; remove those rows")
    return q


def shaped(arrays: Arrays, **shapes: tuple[int | str, ...]) -> dict[str, NDArray[Any]]:
    """Return arrays of a file after checking them.

    >>> shaped(arrays, offset=(6,), radii=(3, "k"), linear=(3, "d"))

    Args:
        arrays: of a model's file.
        shapes: by name; a letter stands for any length, the same wherever it stands.

    Raises:
        TrocarError: one is missing, has another shape, or holds what is not finite or absurdly large.
    """
    lengths: dict[str, int] = {}
    found: dict[str, NDArray[Any]] = {}
    for name, shape in shapes.items():
        if name not in arrays:
            raise TrocarError(f"it lacks {name!r}")
        value = arrays[name]
        told = tuple(
            lengths.setdefault(n, value.shape[i]) if isinstance(n, str) and i < value.ndim else n
            for i, n in enumerate(shape)
        )
        if value.shape != told:
            raise TrocarError(f"{name!r} has shape {value.shape}, not {told}")
        # a column that never moved has an infinite scale, and so no weight
        known = value[value != np.inf] if name.endswith("scale") else value
        if value.dtype.kind not in "biuf" or not np.isfinite(known).all() or np.abs(known).max(initial=0.0) > MAX_VALUE:
            raise TrocarError(f"{name!r} holds numbers that no model can have")
        found[name] = value
    return found
