"""The numbers of a study, from the rows of its trials; only the trial being reduced is in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from trocar.eval.conditions import Cell
from trocar.eval.statistics import session_interval
from trocar.report.cells import CellRows, rows_of_cells
from trocar.report.comparison import session_estimate
from trocar.tasks.peg_transfer.study.row import Row, read_row


class Result(CellRows[Row]):
    """The results of a cell."""

    def successes(self) -> tuple[list[int], list[int]]:
        """Return how many transfers succeeded and how many were set, by session."""
        done = self.by_session(lambda row: row.succeeded)
        tried = self.by_session(lambda row: row.attempted)
        return [int(sum(values)) for values in done.values()], [int(sum(values)) for values in tried.values()]

    def summary(self) -> dict[str, Any]:
        """Return the cell's figures as JSON values."""
        done, tried = self.successes()
        failures: Counter[str] = Counter()
        for row in self.rows:
            failures.update(row.failures)
        return {
            "variant": self.cell.variant,
            "method": self.cell.method,
            "folder": self.cell.folder.name,
            "fingerprint": self.cell.config.fingerprint,
            "sessions": len(done),
            "trials": len(self.rows),
            "attempted": sum(tried),
            "available": sum(row.available for row in self.rows),
            "succeeded": sum(done),
            "success_rate": sum(done) / sum(tried),
            "success_ci95": list(session_interval(done, tried)),
            "mean_time_s": _estimate(self, transfer_time_s),
            "completion_time_s": _estimate(self, lambda row: row.duration_s),
            "path_m": _estimate(self, lambda row: row.path_m),
            "collisions_per_trial": _estimate(self, lambda row: float(row.collisions)),
            "failures": dict(failures),
            "joints_rms": _means([row.joints for row in self.rows]),
            "tip_rms": _means([row.tip for row in self.rows]),
            "wall_s_per_trial": float(np.mean([row.wall_s for row in self.rows])),
        }


def transfer_time_s(row: Row) -> float:
    """Return the completion time over the number of transfers, as in the paper's tables."""
    return row.duration_s / row.attempted


def results_of(
    cells: Sequence[Cell], tick: Callable[[str, int, int], None] | None = None
) -> tuple[list[Result], list[str]]:
    """Return the results of all cells that have a trial, and a sentence for each trial that is missing.

    Raises:
        TrocarError: there is no trial at all.
    """
    found, missing = rows_of_cells(cells, read_row, tick)
    return [Result(cell, rows) for cell, rows in found], missing


def _estimate(result: Result, value: Callable[[Row], float]) -> dict[str, Any]:
    values = [value(row) for row in result.rows]
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return {**asdict(session_estimate(result.by_session(value))), "sd": sd, "median": float(np.median(values))}


def _means(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {kind: float(np.mean([row[kind] for row in rows])) for kind in rows[0]}
