"""The numbers of a study, from the rows of its trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trocar.eval.conditions import Cell
from trocar.eval.rows import kept_row
from trocar.report.cells import CellRows, rows_of_cells
from trocar.report.comparison import ratio_of_ratios
from trocar.tasks.debridement.report.figures import Row, figures_of, row_of
from trocar.tasks.debridement.report.table_one import MODES, SPEEDUP, TABLE_1, within

VERSION = 1
"""Version of rows: a change causes stored ones to be made again."""


class Result(CellRows[Row]):
    """The results of a cell."""

    def summary(self) -> dict[str, Any]:
        """Return the cell's figures as JSON values, and which failure modes are within the paper's intervals."""
        variant, figures = self.cell.variant, figures_of(self.rows)
        return {
            "variant": variant,
            "method": self.cell.method,
            "folder": self.cell.folder.name,
            "fingerprint": self.cell.config.fingerprint,
            "sessions": len({row.session for row in self.rows}),
            "trials": len(self.rows),
            **figures,
            "within_paper": {mode: within(variant, mode, figures) for mode in MODES},
        }


def read_row(trial: Path, fingerprint: str) -> Row:
    """Return the row of a trial's file; it is made and stored if there is no valid one.

    Raises:
        TrocarError: the trial cannot be read.
    """
    return kept_row(trial, fingerprint, Row, VERSION, row_of)


def results_of(
    cells: Sequence[Cell], tick: Callable[[str, int, int], None] | None = None
) -> tuple[list[Result], list[str]]:
    """Return the results of all cells that have a trial, and a sentence for each trial that is missing.

    Raises:
        TrocarError: there is no trial at all.
    """
    found, missing = rows_of_cells(cells, read_row, tick)
    return [Result(cell, rows) for cell, rows in found], missing


def speedups(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Return, for each method run with both, how many times faster two arms were than one (VI-A: 1.5)."""
    one, two = ({r.cell.method: r for r in results if r.cell.variant == variant} for variant in TABLE_1)
    found = []
    for method in one:
        if method in two:
            first, second = (each[method].by_session(_seconds_and_fragments) for each in (one, two))
            ratio = ratio_of_ratios(first, second)
            sessions = len(first.keys() & second.keys())
            estimate = asdict(ratio) if ratio else None
            found.append({"method": method, "sessions": sessions, "one_over_two": estimate, "paper": SPEEDUP})
    return found


def _seconds_and_fragments(row: Row) -> tuple[float, float]:
    return row.duration_s, float(row.cleared)
