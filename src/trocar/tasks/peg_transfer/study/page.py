"""The page of a study, to be opened in a browser."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.report.page import STYLE
from trocar.tasks.peg_transfer.study.hypotheses import NOTES, Finding
from trocar.tasks.peg_transfer.study.published import TABLES
from trocar.tasks.peg_transfer.study.tables import HEAD, HYPOTHESIS_HEAD, cell_rows, hypothesis_rows

CAPTIONS = {
    "paths.png": "Paths of the tips over the board, first trial of each condition (Fig. 9 of the paper in kind)",
    "performance.png": "Success, distance, collisions, completion time (Fig. 10 in kind); people as published",
    "motion.png": "Velocity, acceleration, jerk from the measured joints (Fig. 11 in kind)",
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
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>",
        f"<title>Study: peg transfer</title><style>{STYLE}</style>",
        "<h1>Study: peg transfer</h1>",
        f"<p class=sub>Simulated, {summary['transfers']} transfers in {summary['trials']} trials. The paper's rows "
        "(Hwang et al. 2022) are as published. Research use only, not a medical device.</p>",
    ]
    for variant in dict.fromkeys(cell["variant"] for cell in cells):
        parts.append(f"<h2>{TABLES.get(variant, '')} {html.escape(variant)}</h2>")
        parts.append(_table(HEAD, cell_rows(variant, cells)))
    parts.append("<h2>H1 to H4</h2>" + _table(HYPOTHESIS_HEAD, hypothesis_rows(found)))
    parts += [
        f'<p><img src="{picture.name}" alt="{picture.stem}"><br>{CAPTIONS.get(picture.name, "")}</p>'
        for picture in pictures
    ]
    parts.append("<h2>Noted</h2><ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in [*NOTES, *notes]) + "</ul>")
    links = "".join(
        f'<li><a href="{cell["folder"]}">{html.escape(cell["folder"])}</a>: a folder for <code>trocar report</code> '
        "and <code>trocar view</code></li>"
        for cell in cells
    )
    parts.append(f"<h2>Runs</h2><ul>{links}</ul></html>\n")
    path.write_text("".join(parts), encoding="utf-8")
    return path


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{html.escape(cell)}</{kind}>" for cell in cells) + "</tr>"

    return "<table>" + line(head, "th") + "".join(line(row, "td") for row in rows) + "</table>"
