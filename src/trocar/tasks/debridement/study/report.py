"""Everything in a study's folder besides its runs: summary, figures, page."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.files.output import write_json
from trocar.report.page.elements import captioned, table
from trocar.report.page.study_page import study_page
from trocar.report.tables import figure
from trocar.tasks.debridement.report import ASSUMED, draw_failures
from trocar.tasks.debridement.report.table_one import estimated, head_of, lines_of
from trocar.tasks.debridement.study.results import Result, speedups
from trocar.tasks.debridement.study.times import draw_times

NOTES = (
    "rates: 95 % intervals of a beta-binomial over sessions; times and replans: Student's t over sessions; one arm "
    "against two: sessions resampled 10000 times, the same ones for both",
    "the paper's rates: Clopper-Pearson intervals, as if counted of its fragments, 60 of the robot and 30 of the "
    "person; within: whether our rate lies in that interval",
    *ASSUMED,
)
CAPTIONS = {
    "times.png": "Time per fragment by part; pale: Table I as published",
    "failures.png": "The nine failure modes of section III-B",
}
SPEED_HEAD = ("method", "sessions", "s per fragment, one arm over two", "paper")


def summary_of(results: Sequence[Result]) -> dict[str, Any]:
    """Return the content of a study's ``summary.json``."""
    cells = [result.summary() for result in results]
    config = results[0].cell.config
    return {
        "study": "debridement",
        "seed": config.seed,
        "station": config.laboratory.name,
        "difficulty": config.how_difficult,
        "trials": sum(cell["trials"] for cell in cells),
        "fragments": sum(cell["fragments"] for cell in cells),
        "cleared": sum(cell["cleared"] for cell in cells),
        "cells": cells,
        "speedups": speedups(results),
        "statistics": list(NOTES),
        "versions": config.about()["versions"],
    }


def by_method(cells: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Return the cells by method, then by variant."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for cell in cells:
        found.setdefault(cell["method"], {})[cell["variant"]] = cell
    return found


def speed_lines(found: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a line for each method that was run with one arm and with two."""
    return [
        (one["method"], str(one["sessions"]), estimated(one["one_over_two"], 2), figure(one["paper"])) for one in found
    ]


def left_behind(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each condition that did not clear everything, or did not finish."""
    found = []
    for cell in cells:
        left, stopped = cell["fragments"] - cell["cleared"], cell["unfinished_trials"]
        if left or stopped:
            why = ", ".join(f"{name.lower().replace('_', ' ')} {count}" for name, count in cell["left_behind"].items())
            found.append(
                f"{cell['variant'].replace('-', ' ')}, {cell['method']}: {left} of {cell['fragments']} fragments left "
                f"behind ({why}); {stopped} of {cell['trials']} trials stopped before their end"
            )
    return found


def write_study(folder: Path, results: Sequence[Result], notes: Sequence[str]) -> tuple[dict[str, Any], list[Path]]:
    """Write summary, figures and page of a study; return the summary and the files.

    Args:
        folder: of the study.
        results: of its cells.
        notes: sentences on what is missing.
    """
    summary = summary_of(results)
    path = write_json(folder / "summary.json", summary, "summary of a study")
    ours = [(cell["variant"], cell["method"], cell) for cell in summary["cells"]]
    pictures = [draw_times(ours, folder / "times.png"), draw_failures(ours, folder / "failures.png")]
    parts = []
    for method, cells in by_method(summary["cells"]).items():
        parts.append(f"<h2>Table I, {html.escape(method)}</h2>" + table(head_of(list(cells)), lines_of(cells)))
    if summary["speedups"]:
        parts.append("<h2>One arm against two</h2>" + table(SPEED_HEAD, speed_lines(summary["speedups"])))
    sub = (
        f"Simulated, {summary['cleared']} of {summary['fragments']} fragments cleared in {summary['trials']} trials. "
        "The paper's columns (Kehoe et al. 2014, Table I) are as published."
    )
    page = study_page(
        folder / "report.html",
        "Study: debridement",
        sub,
        [*parts, *captioned(pictures, CAPTIONS)],
        [*left_behind(summary["cells"]), *NOTES, *notes],
        [cell["folder"] for cell in summary["cells"]],
    )
    return summary, [path, *pictures, page]
