"""Parts that several pages share: figures of a run as text, and the outcomes of goals."""

from __future__ import annotations

import os
from html import escape

from trocar.eval.trial import Trial
from trocar.report.browse.shelf import Run
from trocar.report.page import range_of
from trocar.report.tables import figure, percent


def how_many(run: Run) -> str:
    """Return sessions and trials: ``3 × 2`` if each session has as many, else ``5 in 3``; empty without trials."""
    if not run.figures:
        return ""
    sessions, trials = run.figures["sessions"], run.figures["trials"]
    return f"{trials} in {sessions}" if trials % sessions else f"{sessions} × {trials // sessions}"


def success(run: Run) -> str:
    """Return the success of a run with its interval, in HTML; empty without trials."""
    if not run.figures:
        return ""
    low, high = run.figures["success_ci95"]
    rate = run.figures["success_rate"]
    bar = "" if rate is None else range_of(rate, low, high)
    interval = f"<span class=quiet>({100 * low:.0f} to {100 * high:.0f})</span>"
    counts = f"{run.figures['succeeded']} of {run.figures['attempted']}"
    return f"<span class=whole>{bar}{escape(percent(rate))} {interval} {counts}</span>"


def figure_of(run: Run, key: str) -> str:
    """Return one of a run's figures; empty without trials."""
    return figure(run.figures[key]) if run.figures else ""


def remarks(run: Run) -> list[str]:
    """Return what is wrong with a run, with file names relative to its folder, which is shown beside the remarks."""
    return [said.replace(f"{run.folder}{os.sep}", "") for said in run.remarks]


def missed(trial: Trial) -> bool:
    """Return whether something of a trial failed: a goal, or its script."""
    return not trial.finished or not all(score["succeeded"] for score in trial.scores)


def whole(text: object) -> str:
    """Return text that does not wrap, in HTML; empty if there is none."""
    return f"<span class=whole>{escape(str(text))}</span>" if text else ""
