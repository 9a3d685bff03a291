"""Joint states in CSV files with a header."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.tasks.suture.demonstrations.convention import Convention


def read_table(path: str | Path, convention: Convention, episode: int | None = None) -> NDArray[np.float64]:
    """Return the joint values (n, 6 arms) of a CSV file with a header.

    Unless the manifest names or numbers them, the columns are ``q1`` to ``q6`` or the arm's joint names (``yaw``,
    ``pitch``, ...), with a prefix per arm if there are several (``psm1_yaw``, ``psm2_yaw``); other columns, such as
    times, are ignored.

    Raises:
        TrocarError: the file is not such a table.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error):
        raise TrocarError(f"{str(path)!r} is not a readable CSV; export it again as UTF-8 text") from None
    if not rows:
        raise TrocarError(f"{str(path)!r} is empty; it needs a header and a row for each joint state")
    header = [name.strip() for name in rows[0]]
    where = _columns(header, convention, path)
    values = np.empty((len(rows) - 1, len(where)))
    for r, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise TrocarError(f"{str(path)!r}: row {r} has {len(row)} values and the header {len(header)}; repair it")
        for c, column in enumerate(where):
            try:
                values[r, c] = float(row[column])
            except ValueError:
                raise TrocarError(
                    f"{str(path)!r}: row {r} holds {row[column]!r} for {header[column]}; give a number"
                ) from None
    return values


def _columns(header: list[str], convention: Convention, path: Path) -> list[int]:
    """Return the indices of the joints' columns, in order."""
    if all(_is_number(name) for name in header):
        raise TrocarError(f"{str(path)!r} has no header; write the joints' names, or q1 to q6, into its first row")
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise TrocarError(f"{str(path)!r} has more than one column {twice!r}; give each its own name")
    if convention.columns is not None:
        return [_column(header, column, path) for column in convention.columns]
    joint_names = [joint.name for joint in convention.arms[0].joints]
    for names in (joint_names, [f"q{i}" for i in range(1, 7)]):
        prefixes = [name.removesuffix(names[0]) for name in header if name.endswith(names[0])]
        prefixes = [prefix for prefix in prefixes if all(prefix + name in header for name in names)]
        if len(prefixes) == len(convention.arms):
            return [header.index(prefix + name) for prefix in prefixes for name in names]
    prefix = "" if len(convention.arms) == 1 else "psm1_"
    raise TrocarError(
        f"{str(path)!r} has the columns {', '.join(header[:14])}; {len(convention.arms)} arm(s) need six each, called "
        f"{prefix}{joint_names[0]}, {prefix}{joint_names[1]}, ... or {prefix}q1 to {prefix}q6, or named in the manifest"
    )


def _column(header: list[str], column: int | str, path: Path) -> int:
    if isinstance(column, str) and column in header:
        return header.index(column)
    if isinstance(column, int) and 0 <= column < len(header):
        return column
    raise TrocarError(f"{str(path)!r} has no column {column!r}; it has {', '.join(header)}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
