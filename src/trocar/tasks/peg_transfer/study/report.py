"""Everything in a study's folder besides its runs: summary, figures, page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trocar.files.output import write_json
from trocar.tasks.peg_transfer.study.figures import draw_motion, draw_paths, draw_performance
from trocar.tasks.peg_transfer.study.hypotheses import NOTES, Finding, findings
from trocar.tasks.peg_transfer.study.page import write_page
from trocar.tasks.peg_transfer.study.results import Result

FILES = ("summary.json", "paths.png", "performance.png", "motion.png", "report.html")


def summary_of(results: Sequence[Result], found: Sequence[Finding]) -> dict[str, Any]:
    """Return the content of a study's ``summary.json``."""
    cells = [result.summary() for result in results]
    config = results[0].cell.config
    return {
        "study": "peg-transfer",
        "seed": config.seed,
        "station": config.laboratory.name,
        "difficulty": config.how_difficult,
        "model": next((result.cell.config.model for result in results if result.cell.config.model), None),
        "trials": sum(cell["trials"] for cell in cells),
        "transfers": sum(cell["attempted"] for cell in cells),
        "cells": cells,
        "hypotheses": [finding.summary() for finding in found],
        "statistics": list(NOTES),
        "versions": config.about()["versions"],
    }


def write_study(
    folder: Path, results: Sequence[Result], notes: Sequence[str]
) -> tuple[dict[str, Any], list[Finding], list[Path]]:
    """Write summary, figures and page of a study; return the summary, the findings on H1 to H4, and the files."""
    found = findings(results)
    summary = summary_of(results, found)
    path = write_json(folder / "summary.json", summary, "summary of a study")
    pictures = [
        draw_performance(results, folder / "performance.png"),
        draw_motion(results, folder / "motion.png"),
        draw_paths(results, folder / "paths.png"),
    ]
    page = write_page(folder / "report.html", summary, found, pictures, notes)
    return summary, found, [path, *pictures, page]
