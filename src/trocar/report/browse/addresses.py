"""Addresses of the pages, which mirror the folders of runs."""

from __future__ import annotations

from urllib.parse import quote, urlencode

from trocar.report.browse.shelf import Run

ALL = "/"
REPORT = "report.html"


def of_run(run: Run) -> str:
    """Return the address of a run's page."""
    return f"/runs/{quote(run.name, safe='')}/"


def of_trial(run: Run, session: int, index: int, goal: int | None = None) -> str:
    """Return the address of a trial's page; with a goal's number, its replay starts at that goal."""
    asked = "" if goal is None else f"?goal={goal}"
    return f"{of_run(run)}session_{session:02d}/trial_{index:03d}/{asked}"


def of_pair(one: Run, two: Run) -> str:
    """Return the address of two runs side by side."""
    return f"/compare?{urlencode([('run', one.name), ('run', two.name)])}"
