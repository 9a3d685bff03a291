"""The page of a study, to be opened in a browser."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.report.page.elements import captioned, table
from trocar.report.page.study_page import study_page
from trocar.tasks.peg_transfer.study.hypotheses import NOTES, Finding
from trocar.tasks.peg_transfer.study.published import TABLES
from trocar.tasks.peg_transfer.study.tables import HEAD, HYPOTHESIS_HEAD, cell_rows, hypothesis_rows

CAPTIONS = {
    "paths.png": "Paths of the tips over the board, first trial of each condition (like Fig. 9 of the paper)",
    "performance.png": "Success, distance, collisions, completion time (like Fig. 10); people as published",
    "motion.png": "Velocity, acceleration, jerk from the measured joints (like Fig. 11)",
}


def write_page(
    path: Path, summary: Mapping[str, Any], found: Sequence[Finding], pictures: Sequence[Path], notes: Sequence[str]
) -> Path:
    """Write the page of a study and return its path.

    Args:
        path: of the page; the pictures lie beside it.
        summary: keys as in ``summary.json``.
        found: on the hypotheses.
        pictures: in order.
        notes: sentences on what is missing.
    """
    cells = summary["cells"]
    parts = []
    for variant in dict.fromkeys(cell["variant"] for cell in cells):
        parts.append(f"<h2>{TABLES.get(variant, '')} {html.escape(variant)}</h2>")
        parts.append(table(HEAD, cell_rows(variant, cells)))
    parts.append("<h2>H1 to H4</h2>" + table(HYPOTHESIS_HEAD, hypothesis_rows(found)))
    sub = (
        f"Simulated, {summary['transfers']} transfers in {summary['trials']} trials. The paper's rows (Hwang et al. "
        "2022) are as published."
    )
    return study_page(
        path,
        "Study: peg transfer",
        sub,
        [*parts, *captioned(pictures, CAPTIONS)],
        [*NOTES, *notes],
        [cell["folder"] for cell in cells],
    )
