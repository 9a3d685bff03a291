"""The table of all runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from trocar.counting import counted
from trocar.report.browse import addresses
from trocar.report.browse.cells import figure_of, how_many, remarks, success, whole
from trocar.report.browse.shelf import Run
from trocar.report.failures import flagged
from trocar.report.page import Column, document, link, listing

MOST = 2
"""Maximum number of remarks beside a run."""


@dataclass(frozen=True)
class Property:
    """A column: its heading, its cell for a run (HTML), and the key to sort runs by (None: unknown, sorted last)."""

    name: str
    shown: Callable[[Run], str]
    sorted_by: Callable[[Run], Any]
    number: bool = False


def _text(key: str) -> Property:
    return Property(key, lambda run: whole(run.about.get(key) or ""), lambda run: run.about.get(key) or None)


def _figure(name: str, key: str) -> Property:
    return Property(name, lambda run: figure_of(run, key), lambda run: run.figures.get(key), number=True)


PROPERTIES = {
    "run": Property("run", lambda run: link(addresses.of_run(run), run.name), lambda run: run.name),
    **{key: _text(key) for key in ("task", "variant", "method")},
    "difficulty": Property("difficulty", lambda run: whole(run.difficulty), lambda run: run.difficulty or None),
    "trials": Property(
        "sessions × trials", lambda run: whole(how_many(run)), lambda run: run.figures.get("trials"), number=True
    ),
    "success": Property("success (95 %)", success, lambda run: run.figures.get("success_rate")),
    "time": _figure("s per goal", "mean_time_s"),
    "collisions": _figure("collisions per trial", "collisions_per_trial"),
    "version": Property("version", lambda run: whole(run.version), lambda run: run.version or None),
}
"""The columns, by their names in the page's address."""


def all_runs_page(runs: Sequence[Run], folders: Sequence[str | Path], by: str, down: bool) -> str:
    """Return the page of all runs.

    Args:
        runs: the runs found.
        folders: the folders searched.
        by: which of ``PROPERTIES`` they are sorted by.
        down: whether the largest comes first.
    """
    where = ", ".join(map(str, folders))
    trials = sum(len(run.trials) for run in runs)
    sub = [
        f"{counted(len(runs), 'run')} with {counted(trials, 'trial')} in {where}.",
        "Intervals count sessions. New runs and trials appear when the page is loaded again.",
    ]
    if not runs:
        return document("Runs", [f"No run in {where}.", "Make one with trocar run TASK --out FOLDER."], [])
    columns = [Column("")] + [_column(key, by, down) for key in PROPERTIES]
    ordered = _sorted(runs, by, down)
    rows = [[_tick(run), *(one.shown(run) for one in PROPERTIES.values())] for run in ordered]
    table = listing(columns, rows, map(_remark, ordered))
    form = f"<form action=/compare><p>Tick two runs to see them <button>side by side</button></p>{table}</form>"
    return document("Runs", sub, [form if len(runs) > 1 else table], broad=True)


def _remark(run: Run) -> str:
    """Return what is wrong with a run, in HTML; empty if nothing is."""
    more = [f"{len(run.remarks) - MOST} more"] if len(run.remarks) > MOST else []
    return flagged("; ".join([*remarks(run)[:MOST], *more]))


def _tick(run: Run) -> str:
    name = escape(run.name)
    return f'<input type=checkbox name=run value="{name}" aria-label="compare {name}">' if run.trials else ""


def _column(key: str, by: str, down: bool) -> Column:
    one, chosen = PROPERTIES[key], key == by
    asked = {"by": key, **({"down": 1} if chosen and not down else {})}
    order = ("descending" if down else "ascending") if chosen else ""
    return Column(one.name, one.number, f"{addresses.ALL}?{urlencode(asked)}", order)


def _sorted(runs: Sequence[Run], by: str, down: bool) -> list[Run]:
    value = PROPERTIES[by].sorted_by
    known = [run for run in runs if value(run) is not None]
    return sorted(known, key=value, reverse=down) + [run for run in runs if value(run) is None]
