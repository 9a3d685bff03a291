"""Rows: what a study needs from a trial, reduced from its file and stored beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar

from trocar.eval.trial import Trial
from trocar.files.output import MADE_BY, write_json
from trocar.files.reading import read_json


class Row(Protocol):
    """One trial in a study; a dataclass whose fields are JSON's values."""

    @property
    def fingerprint(self) -> str:
        """Return the fingerprint of its run."""
        ...

    @property
    def session(self) -> int:
        """Return its number."""
        ...


AnyRow = TypeVar("AnyRow", bound=Row)


def row_file(trial: str | Path) -> Path:
    """Return the path of a trial's row."""
    return Path(trial).with_suffix(".row.json")


def kept_row(
    trial: str | Path, fingerprint: str, kind: Callable[..., AnyRow], version: int, made: Callable[[Trial], AnyRow]
) -> AnyRow:
    """Return the row of a trial's file; it is made and stored if there is no valid one.

    Args:
        trial: its file.
        fingerprint: of its run.
        kind: class of the row.
        version: of the row's fields and of how they are made.
        made: makes the row of a trial.

    Raises:
        TrocarError: the trial cannot be read.
    """
    path = row_file(trial)
    try:
        values = read_json(path)
        values.pop(MADE_BY, None)
        if values.pop("version") == version and values["fingerprint"] == fingerprint:
            return kind(**values)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        pass
    row = made(Trial.load(trial))
    values: dict[str, Any] = {"version": version, **asdict(row)}  # type: ignore[call-overload]
    path.unlink(missing_ok=True)  # the trial has the same information: nothing is lost if the row is invalid
    write_json(path, values, "row of a trial")
    return row
