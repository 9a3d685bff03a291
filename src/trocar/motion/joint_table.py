"""Recorded joints in a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar.errors import BadFile, InvalidInput
from trocar.files.csv_file import TIMES, read_csv
from trocar.geometry.arrays import Array
from trocar.motion.analysis import SHORTEST

OFF_GRID = 0.3  # a step may differ by this share from the median step, or from a multiple of it if samples are missing


@dataclass(frozen=True, eq=False)
class JointTable:
    """Signals at even steps."""

    names: tuple[str, ...]  # of the columns, without that of times
    values: Array  # (n, k), rad and m; NaN where there is no measurement
    step_s: float  # between samples

    def columns(self, names: list[str], path: str | Path) -> Array:
        """Return the values (n, len(names)) of these columns (BadFile, which names ``path``: one is missing)."""
        missing = [name for name in names if name not in self.names]
        if missing:
            problem = f"has no column {missing[0]!r}; it has {', '.join(self.names)}"
            raise BadFile(path, problem, "name yours with --columns")
        return self.values[:, [self.names.index(name) for name in names]]


def read_joint_table(path: str | Path, rate_hz: float | None = None) -> JointTable:
    """Return the signals in a CSV file whose first line names the columns; an empty cell is a missing measurement.

    Args:
        path: of the file.
        rate_hz: of the samples, if there is no column of times (``t_s``, ``time_s``, ``t`` or ``time``, in s).

    Raises:
        TrocarError: there is no such file, a cell is not a number, or the times are not even.
    """
    names, rows = read_csv(path, "t_s,q1,q2,q3,q4,q5,q6")
    if len(rows) < SHORTEST:
        raise BadFile(path, f"has {len(rows)} rows of numbers", f"{SHORTEST} are needed at least")
    time_name = next((name for name in TIMES if name in names), None)
    signals = [place for place, name in enumerate(names) if name != time_name]
    if not signals:
        raise BadFile(path, "has no column besides the times", "give one for each joint")
    kept = tuple(names[place] for place in signals)
    if time_name is None:
        if rate_hz is None:
            raise BadFile(path, f"has no column {TIMES[0]!r}", "add one, or give --rate in Hz")
        return JointTable(kept, rows[:, signals], 1.0 / rate_hz)
    times_s = rows[:, names.index(time_name)]
    return JointTable(kept, *_on_grid(times_s, rows[:, signals], path))


def _on_grid(times_s: Array, values: Array, path: str | Path) -> tuple[Array, float]:
    """Return the values at even steps, NaN where a sample is missing, and the step."""
    steps = np.diff(times_s)
    if not np.isfinite(times_s).all() or (steps <= 0).any():
        row = 1 + int(np.argmax(~(steps > 0)))  # counted from the first line of numbers
        problem = f"of {str(path)!r} do not increase at row {row + 2}"
        raise InvalidInput("times", problem, "sort the rows, drop repeated ones")
    counts = steps / np.median(steps)
    off = np.abs(counts - np.rint(counts))
    if off.max() > OFF_GRID or counts.min() < 0.5:
        row = int(np.argmax(np.maximum(off, counts < 0.5)))
        uneven = f"the step to row {row + 3} is {1e3 * steps[row]:.2f} ms, most are {1e3 * np.median(steps):.2f} ms"
        raise InvalidInput("times", f"of {str(path)!r} are not even: {uneven}", "resample the recording to even steps")
    index = np.concatenate([[0], np.cumsum(np.rint(counts))]).astype(int)
    step_s = float(np.polyfit(index, times_s, 1)[0])
    if index[-1] + 1 > 2 * len(times_s):
        problem = f"of the samples of {str(path)!r} are missing"
        raise InvalidInput("more than half", problem, "cut it into parts without gaps")
    grid = np.full((index[-1] + 1, values.shape[1]), np.nan)
    grid[index] = values
    return grid, step_s
