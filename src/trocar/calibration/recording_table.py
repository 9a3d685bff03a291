"""Recordings as CSV files: a column for each commanded and each measured joint, its unit in its name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.files.csv_file import TIMES, read_csv

UNITS = ("rad", "rad", "m", "rad", "rad", "rad")
COMMANDED, MEASURED = (
    tuple(f"q{number}_{kind}_{unit}" for number, unit in enumerate(UNITS, 1)) for kind in ("commanded", "measured")
)
VALID = "valid"
EXAMPLE = f"time_s,{COMMANDED[0]},...,{COMMANDED[-1]},{MEASURED[0]},...,{MEASURED[-1]}"


def read_recording_table(path: str | Path) -> dict[str, NDArray[Any]]:
    """Return ``q_cmd`` and ``q_phy`` (n, 6) of a CSV file, and ``t_s`` and ``valid`` (n,) where it has them.

    Its columns are :data:`COMMANDED` and :data:`MEASURED`, in any order, one of times, and ``valid`` (1 or 0). An empty
    cell is a missing measurement.

    Raises:
        TrocarError: it is no such table, lacks a column, has one that no recording has, or a command is missing.
    """
    names, rows = read_csv(path, EXAMPLE)
    times = [name for name in names if name in TIMES]
    _require_columns(path, names, times)
    found: dict[str, NDArray[Any]] = {
        key: rows[:, [names.index(name) for name in columns]]
        for key, columns in (("q_cmd", COMMANDED), ("q_phy", MEASURED))
    }
    missing = np.argwhere(np.isnan(found["q_cmd"]))
    if len(missing):
        row, joint = missing[0]
        raise TrocarError(
            f"row {row + 2} of {str(path)!r} has no number under {COMMANDED[joint]!r}; models need the whole history "
            "of commands, so fill it in, or cut the recording there"
        )
    if times:
        found["t_s"] = rows[:, names.index(times[0])]
    if VALID in names:
        found["valid"] = rows[:, names.index(VALID)]
    return found


def _require_columns(path: str | Path, names: list[str], times: list[str]) -> None:
    """Raise TrocarError unless these are the columns of a recording."""
    known = {*COMMANDED, *MEASURED, VALID}
    for name in names:
        other = re.fullmatch(r"(q[1-6]_(?:commanded|measured))_?(\w*)", name)
        if other and name not in known:
            meant = next(column for column in known if column.startswith(other[1]))
            unit = f"in {other[2]!r}" if other[2] else "without a unit"
            wanted = meant.rpartition("_")[2]
            raise TrocarError(f"column {name!r} of {str(path)!r} is {unit}; give it in {wanted} and call it {meant!r}")
    missing = [name for name in (*COMMANDED, *MEASURED) if name not in names]
    if missing:
        raise TrocarError(
            f"recording {str(path)!r} lacks column {', '.join(missing)}; it has {', '.join(names)[:200]}, and needs "
            f"{EXAMPLE}"
        )
    strange = [name for name in names if name not in known and name not in times]
    if strange or len(times) > 1:
        raise TrocarError(
            f"recording {str(path)!r} has a column {(strange or times)[-1]!r} too many; besides the twelve of the "
            f"joints it may have one of times ({' or '.join(TIMES[:2])}) and {VALID!r} (1 or 0), so leave it out"
        )
