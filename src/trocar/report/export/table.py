"""A flat table: named columns of equal length, each with its unit and what it means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.files.output import write_table

Kind = Literal["text", "integer", "number", "truth"]


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        name: in the table's first line, with the unit for numbers.
        about: what it means.
        kind: of its values.
        unit: of its values; empty if they have none.
    """

    name: str
    about: str
    kind: Kind = "text"
    unit: str = ""


@dataclass(frozen=True, eq=False)
class FlatTable:
    """Columns with their values.

    Attributes:
        name: what one row is, in the plural.
        columns: in order.
        values: of each column, all of the same length; None for a missing value.
    """

    name: str
    columns: tuple[Column, ...]
    values: tuple[Sequence[Any] | NDArray[Any], ...]

    def __len__(self) -> int:
        return len(self.values[0])

    @staticmethod
    def of_rows(name: str, columns: Sequence[Column], rows: Sequence[Sequence[Any]]) -> FlatTable:
        """Return the table of these rows."""
        values = tuple(list(column) for column in zip(*rows, strict=True)) if rows else ([],) * len(columns)
        return FlatTable(name, tuple(columns), values)

    def write_csv(self, path: str | Path) -> Path:
        """Write it as CSV: empty cells are missing values, booleans ``true`` or ``false``, numbers have nine digits."""
        cells = [
            list(map(_SHOWN[column.kind], values)) for column, values in zip(self.columns, self.values, strict=True)
        ]
        return write_table(path, [column.name for column in self.columns], zip(*cells, strict=True))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.9g}"


def _text(value: object) -> str:
    return "" if value is None else str(value)


def _truth(value: bool | None) -> str:
    return "" if value is None else str(bool(value)).lower()


_SHOWN: dict[Kind, Callable[[Any], str]] = {"text": _text, "integer": _text, "number": _number, "truth": _truth}


def kind_of(values: Sequence[Any]) -> Kind:
    """Return the type that fits all of these values."""
    there = [value for value in values if value is not None]
    if there and all(isinstance(value, bool | np.bool_) for value in there):
        return "truth"
    if there and all(isinstance(value, int) and not isinstance(value, bool) for value in there):
        return "integer"
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in there)
    return "number" if there and numbers else "text"
