"""What every cable model offers, and how it is kept in a file."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.calibration.recording import Recording, sampling_interval
from trocar.errors import TrocarError

FORMAT = "trocar cable model"
VERSION = 1
MINIMUM_ROWS = 30
"""Fewer valid rows than this cannot identify a model's offsets, let alone its hysteresis."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class TrainingMotion:
    """The motion that a model was fitted on, in joint space.

    Attributes:
        interval: (6,) mean step |dq| between samples, rad and m (q3); tasks are resampled to it.
        lower: (6,) least command.
        upper: (6,) greatest command.
        rows: valid rows used.
    """

    interval: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    rows: int

    @staticmethod
    def of(recording: Recording) -> TrainingMotion:
        """Return the statistics of a recording that is long enough to fit on."""
        rows = int(recording.valid.sum())
        if rows < MINIMUM_ROWS:
            raise TrocarError(
                f"{recording.name} has {rows} valid rows; a fit needs {MINIMUM_ROWS} or more, take more of it"
            )
        q = recording.q_cmd[: int(np.flatnonzero(recording.valid)[-1]) + 1]
        return TrainingMotion(sampling_interval(q), q.min(axis=0), q.max(axis=0), rows)


class CableModel(Protocol):
    """A forward model of the cables: joints from the history of commands.

    ``step`` is pure: it returns the joints and a new state and leaves the old state as it was, so that a
    controller can try several commands from one state.
    """

    name: ClassVar[str]
    rate_independent: ClassVar[bool]
    """Whether the joints depend on the path of the commands alone, however densely it is sampled."""

    @property
    def training(self) -> TrainingMotion:
        """The motion it was fitted on."""
        ...

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model fitted on the valid rows; every command goes through its memory."""
        ...

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) along a whole history of commands (n, 6)."""
        ...

    def start(self, q_cmd: NDArray[np.float64]) -> Any:
        """Return the state of an arm that has rested at this command (6,)."""
        ...

    def step(self, state: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], Any]:
        """Return the joints (6,) after the command (6,), and the new state."""
        ...

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model with this (6,) added to every prediction: the same cables in another session."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all that :meth:`from_arrays` needs, apart from the training motion."""
        ...

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model that :meth:`arrays` described."""
        ...


def commands(q_cmd: ArrayLike) -> NDArray[np.float64]:
    """Return a history of commands as float64 (n, 6) after checking it."""
    q = np.asarray(q_cmd, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != 6:
        raise TrocarError(f"commands have shape {q.shape}; they need (n, 6), one row a sample of q1 to q6")
    if not np.all(np.isfinite(q)):
        raise TrocarError("commands hold NaN or infinity; remove those rows")
    return q


def save_model(model: CableModel, path: str | Path) -> Path:
    """Write the model as one ``.npz``; an interrupted write leaves an older file as it was."""
    path = Path(path)
    if path.suffix != ".npz":
        raise TrocarError(f"model file {str(path)!r} must end in .npz; choose such a name")
    training = model.training
    header = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "name": np.array(model.name),
        "training_interval": training.interval,
        "training_lower": training.lower,
        "training_upper": training.upper,
        "training_rows": np.array(training.rows),
    }
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with draft.open("wb") as file:
            np.savez(file, **header, **model.arrays())  # type: ignore[arg-type]
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise TrocarError(f"cannot write model {str(path)!r} ({error.strerror}); choose another folder") from None
    return path


def load_model(path: str | Path) -> CableModel:
    """Return the model in an ``.npz`` that :func:`save_model` wrote."""
    from trocar.calibration.models import MODELS  # noqa: PLC0415 (the registry imports this module)

    path = Path(path)
    if not path.is_file():
        raise TrocarError(f"model {str(path)!r} does not exist; make one with `trocar calibrate fit`")
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {key: np.asarray(data[key]) for key in data.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, TypeError):
        raise TrocarError(
            f"model {str(path)!r} is not a readable .npz; write it again with `trocar calibrate fit`"
        ) from None
    if str(arrays.get("format")) != FORMAT:
        raise TrocarError(f"{str(path)!r} is no cable model; give a file written by `trocar calibrate fit`")
    if int(arrays.get("version", -1)) != VERSION:
        raise TrocarError(
            f"model {str(path)!r} has version {arrays.get('version')}, Trocar reads {VERSION}; fit it again"
        )
    name = str(arrays.get("name"))
    if name not in MODELS:
        raise TrocarError(f"model {str(path)!r} is of kind {name!r}; this Trocar knows {', '.join(MODELS)}")
    try:
        training = TrainingMotion(
            *(arrays[f"training_{key}"] for key in ("interval", "lower", "upper")),
            rows=int(arrays["training_rows"]),
        )
        return MODELS[name].from_arrays(arrays, training)
    except KeyError as error:
        raise TrocarError(f"model {str(path)!r} lacks {error.args[0]!r}; fit it again") from None
