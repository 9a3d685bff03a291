"""The rows of a study's conditions; only the trial that is being reduced is in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from trocar.errors import TrocarError
from trocar.eval.conditions import Cell
from trocar.eval.rows import AnyRow
from trocar.eval.trial import trial_file

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class CellRows(Generic[AnyRow]):
    """The results of a cell.

    Attributes:
        cell: the cell.
        rows: of its trials.
    """

    cell: Cell
    rows: Sequence[AnyRow]

    def by_session(self, value: Callable[[AnyRow], Value]) -> dict[int, list[Value]]:
        """Return one value per trial, by session."""
        found: dict[int, list[Value]] = {}
        for row in self.rows:
            found.setdefault(row.session, []).append(value(row))
        return found


def rows_of_cells(
    cells: Sequence[Cell],
    read_row: Callable[[Path, str], AnyRow],
    tick: Callable[[str, int, int], None] | None = None,
) -> tuple[list[tuple[Cell, list[AnyRow]]], list[str]]:
    """Return all cells that have a trial with their rows, and a sentence for each trial that is missing.

    Args:
        cells: of the study.
        read_row: returns the row of a trial's file, whose run has this fingerprint.
        tick: for a progress bar.

    Raises:
        TrocarError: there is no trial at all.
    """
    found: list[tuple[Cell, list[AnyRow]]] = []
    missing: list[str] = []
    total, done = sum(len(cell.places) for cell in cells), 0
    for cell in cells:
        rows = []
        for place in cell.places:
            try:
                rows.append(read_row(trial_file(cell.folder, *place), cell.config.fingerprint))
            except TrocarError as error:
                missing.append(f"left aside: {error}")
            done += 1
            if tick is not None:
                tick("reading trials", done, total)
        if rows:
            found.append((cell, rows))
    if not found:
        raise TrocarError("the study has no trial that can be read; run it without --report-only")
    return found, missing
