"""Everything in a study's folder besides its runs: summary, pictures, page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from trocar.eval.study import Results, TableData, TaskStudy
from trocar.files.output import write_json, write_text
from trocar.report.page import Captioned, bullets, document, picture, section, table
from trocar.report.tables import table_of


def summary_of(name: str, study: TaskStudy[Any], results: Sequence[Results[Any]]) -> dict[str, Any]:
    """Return the content of a study's ``summary.json``."""
    cells = []
    for found in results:
        about = {
            "variant": found.condition.name,
            "method": found.condition.method,
            "folder": found.condition.folder.name,
            "fingerprint": found.condition.config.fingerprint,
            "sessions": len({row.session for row in found.rows}),
            "trials": len(found.rows),
        }
        cells.append(about | study.figures(found))
    config = results[0].condition.config
    models = [found.condition.config.model for found in results]
    return {
        "study": name,
        "seed": config.seed,
        "station": config.laboratory.name,
        "difficulty": config.how_difficult,
        "model": next((model for model in models if model), None),
        "trials": sum(cell["trials"] for cell in cells),
        **study.summary(results, cells),
        "cells": cells,
        "statistics": list(study.notes),
        "versions": config.about()["versions"],
    }


def write_study(
    folder: str | Path, name: str, study: TaskStudy[Any], results: Sequence[Results[Any]], missing: Sequence[str]
) -> tuple[dict[str, Any], list[TableData], list[str], list[Path]]:
    """Write summary, pictures and page of a study; return the summary, its tables, its notes, and the files.

    ``name`` is the task's; ``missing`` has a sentence for each trial that is missing.
    """
    folder = Path(folder)
    summary = summary_of(name, study, results)
    difficulty = f"difficulty of the cell: {', '.join(summary['difficulty'])}"
    notes = [*study.remarks(summary), *study.notes, difficulty, *missing]
    path = write_json(folder / "summary.json", summary, "summary of a study")
    pictures, tables = study.pictures(folder, results, summary), study.tables(summary)
    parts = [
        f"<h2>{escape(one.title)}</h2>{table(table_of(one.head, one.rows, caption=one.caption))}" for one in tables
    ]
    links = "".join(
        f'<li><a href="{escape(one)}">{escape(one)}</a>: a folder for <code>trocar report</code> and '
        "<code>trocar view</code></li>"
        for one in (cell["folder"] for cell in summary["cells"])
    )
    browse = "<p>Their failures, and any two side by side: <code>trocar open</code> with this folder.</p>"
    captions = [study.captions[drawn.name] for drawn in pictures]
    parts += [picture(Captioned(one, f"Chart: {said}", said)) for one, said in zip(pictures, captions, strict=True)]
    parts += [section("notes", "Noted", bullets(notes)), section("runs", "Runs", f"<ul>{links}</ul>", browse)]
    about = [study.about(summary), "Research use only, not a medical device."]
    page = write_text(folder / "report.html", document(f"Study: {name.replace('-', ' ')}", about, parts), "report")
    return summary, tables, notes, [path, *pictures, page]
