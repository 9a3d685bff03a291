"""Files of a study of robustness."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trocar.files.output import write_json
from trocar.report.robustness.curves import draw_curves
from trocar.report.robustness.results import Result

NOTES = (
    "intervals of 95 %, over sessions: success beta-binomial, collisions Student's t; all conditions had the same "
    "sessions and scenes",
    "goals reached are counted out of all goals: a block lost in an earlier transfer counts as one that was not moved",
    "a dotted line is the size that recordings show, or that is assumed (docs/simulator.md)",
)


def write_study(
    folder: str | Path, task: str, results: Sequence[Result], missing: Sequence[str]
) -> tuple[dict[str, Any], list[Path]]:
    """Write ``summary.json`` and ``robustness.png``; return the summary and the files."""
    folder = Path(folder)
    rows = [result.summary() for result in results]
    summary = {"study": "robustness", "task": task, "conditions": rows, "notes": [*NOTES, *missing]}
    path = folder / "summary.json"
    write_json(path, summary, "summary of a study")
    return summary, [path, draw_curves(rows, folder / "robustness.png")]
