"""CSV files of numbers whose first line names the columns."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import BadFile, InvalidInput

TIMES = ("t_s", "time_s", "t", "time")
"""Names that a column of times in seconds may have."""


def read_csv(path: str | Path, example: str) -> tuple[list[str], NDArray[np.float64]]:
    """Return the names of the columns and all numbers (n, columns); NaN where a cell is empty.

    Args:
        path: of the file.
        example: an example of a first line, for the error message if there is none.

    Raises:
        TrocarError: there is no such file, it is not a table, its first line does not name columns, or a cell is not a
            number.
    """
    path = Path(path)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise BadFile(path, what, "give a CSV file", kind="recording")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, cells) for cells in reader if cells]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadFile(path, f"cannot be read as CSV ({error})", "give a text file with commas") from None
    if not lines:
        raise BadFile(path, "is empty", f"its first line must name the columns, such as {example}")
    names = [name.strip() for name in lines[0][1]]
    if any(_number(name) is not None for name in names) or len(set(names)) < len(names):
        raise InvalidInput("the first line", f"of {str(path)!r} does not name its columns", f"write e.g. {example}")
    numbers = np.empty((len(lines) - 1, len(names)))
    for row, (line, cells) in enumerate(lines[1:]):
        if len(cells) != len(names):
            problem = f"of {str(path)!r} has {len(cells)} cells, not {len(names)}"
            raise InvalidInput(f"row {line}", problem, "repair the file")
        for column, cell in enumerate(cells):
            value = np.nan if not cell.strip() else _number(cell)
            if value is None or np.isinf(value):
                problem = f"of {str(path)!r} holds {cell.strip()[:20]!r} under {names[column]!r}"
                raise InvalidInput(f"row {line}", problem, "give a number, or nothing where there is no measurement")
            numbers[row, column] = value
    return names, numbers


def _number(cell: str) -> float | None:
    try:
        return float(cell.replace("_", "?"))  # Python's own 1_000 is no number of a table
    except ValueError:
        return None
