"""The numbers of a study of robustness, from the rows of its trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from trocar.eval.statistics import session_interval
from trocar.report.cells import CellRows, rows_of_cells
from trocar.report.comparison import ratio_estimate, session_estimate
from trocar.report.robustness.conditions import Condition, cells_of
from trocar.report.robustness.row import Row, read_row


@dataclass(frozen=True, eq=False)
class Result:
    """The results of a condition: goals reached, of all; collisions per trial; time per goal reached.

    Attributes:
        condition: which.
        rows: of its trials.
    """

    condition: Condition
    rows: Sequence[Row]

    def summary(self) -> dict[str, Any]:
        """Return the figures with their 95 % intervals over sessions, as JSON values."""
        found = CellRows(self.condition.cell, self.rows)
        reached = [sum(values) for values in found.by_session(lambda row: row.succeeded).values()]
        goals = [sum(values) for values in found.by_session(lambda row: row.goals).values()]
        seconds = ratio_estimate(found.by_session(lambda row: (row.duration_s, float(row.succeeded))))
        return {
            "method": self.condition.method,
            "flaw": self.condition.flaw,
            "scale": self.condition.scale,
            "size": self.condition.size,
            "unit": self.condition.unit,
            "folder": self.condition.cell.folder.name,
            "sessions": len(reached),
            "trials": len(self.rows),
            "goals": sum(goals),
            "succeeded": sum(reached),
            "success": sum(reached) / sum(goals),
            "success_ci95": list(session_interval(reached, goals)),
            "collisions_per_trial": asdict(session_estimate(found.by_session(lambda row: float(row.collisions)))),
            "s_per_success": asdict(seconds) if seconds else None,
        }


def results_of(
    conditions: Sequence[Condition], tick: Callable[[str, int, int], None] | None = None
) -> tuple[list[Result], list[str]]:
    """Return the results of all conditions that have a trial, and a sentence for each trial that is missing.

    Raises:
        TrocarError: there is no trial at all.
    """
    found, missing = rows_of_cells(cells_of(conditions), read_row, tick)
    rows: dict[Path, list[Row]] = {cell.folder: of_cell for cell, of_cell in found}
    there = [c for c in conditions if c.cell.folder in rows]
    return [Result(condition, rows[condition.cell.folder]) for condition in there], missing
