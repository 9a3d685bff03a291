"""Moments, tables and figures of debridement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from trocar.replay import Viewpoint
from trocar.tasks.debridement.outcomes import FragmentOutcome
from trocar.tasks.debridement.report.failures import draw_failures
from trocar.tasks.debridement.report.figures import figures_of
from trocar.tasks.debridement.report.published import PERSON, TABLE_1
from trocar.tasks.debridement.report.row import row_of
from trocar.tasks.debridement.report.table_one import table_one
from trocar.tasks.kit import PaperRow, TaskReport, stopped

if TYPE_CHECKING:
    from trocar.trials.trial import Trial

MAX_FAILURES = 3
"""So many failures that a script noted get a picture."""

STEPS = {"closing": "jaws open round it", "pickup": "lifted, and looked at", "releasing": "over the receptacle"}
"""Events of the first grasp, in order, and what is seen then."""

ASSUMED = (
    "s per fragment is the trials' duration over the fragments that were cleared, as in Table I, where all were",
    "time by part is the mean of the working arms, each moment counted once: perception with capture and settling, "
    "motion with jaws; waiting is all else, an arm with nothing left to do included",
    "replans: how often an arm asked for a plan, whether or not one was found",
    "fragment false negatives and positives are counted of fragments, each once; the other modes of attempts, which "
    "are closings of jaws. The paper does not say of what its rates are",
    "assumed: size and weight of fragments, static cling of a quarter of them, latency of camera and computations, the "
    "arms' error field (drawn as large as one recording shows), places where arms rest",
)


class DebridementReport(TaskReport):
    """What a report of debridement shows besides the usual."""

    view = Viewpoint((-0.0745, 0.36, 0.20), (-0.0745, -0.044, -0.146), 1.15)
    parts = ("capture", "perception", "planning", "motion", "jaw", "settling", "waiting")

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the start, the first grasp step by step, each fragment that was cleared, failures, the end."""
        found: list[tuple[str, float]] = [("start", 0.0), *_first_grasp(trial)]
        cleared = [score for score in trial.scores if score["succeeded"]]
        found += [(f"fragment {k} in the receptacle", score["end_s"]) for k, score in enumerate(cleared, start=1)]
        failed = [e for e in trial.events if e["name"] == "fragment" and e["outcome"] != FragmentOutcome.DONE.name]
        found += [(f"{e['arm']}: {_words(e['outcome'])}", e["time_s"]) for e in failed[:MAX_FAILURES]]
        end = (f"end: {len(cleared)} of {len(trial.scores)} cleared", trial.duration_s)
        return sorted([*found, end], key=lambda item: item[1])

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw the failure modes of all trials beside the paper's."""
        about = trials[0].about
        figures = figures_of([row_of(trial) for trial in trials])
        return [draw_failures([(about["variant"], about["method"], figures)], folder / "failures.png")]

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return the figures of Table I."""
        return {"table_1": figures_of([row_of(trial) for trial in trials])}

    def paper_rows(self, summary: Mapping[str, Any]) -> Sequence[PaperRow]:
        """Return the column of Table I with as many arms, and that of the person; they cleared all (VI-A)."""
        columns = (TABLE_1[summary["variant"]], PERSON)
        return [PaperRow(c.who, c.s_per_fragment, c.fragments, c.fragments) for c in columns]

    def tables(self, summary: Mapping[str, Any]) -> list[Table]:
        """Return Table I."""
        variant, method = summary["variant"], summary["method"]
        return [table_one(variant, summary["table_1"], f"Table I, {variant.replace('-', ' ')}, {method}")]

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what stopped a trial, and what is counted and assumed."""
        return [*filter(None, (stopped(trial.events)[1] for trial in trials)), *ASSUMED]


def _first_grasp(trial: Trial) -> list[tuple[str, float]]:
    """Return the steps of the first grasp: when its arm was given a fragment, closed, looked and let go."""
    given = next((event for event in trial.events if event["name"] == "allocated"), None)
    if given is None:
        return []
    arm, since_s = given["arm"], given["time_s"]
    found = [(f"{arm} goes for a fragment", since_s)]
    for name, words in STEPS.items():
        mine = (e for e in trial.events if e["name"] == name and e.get("arm") == arm and e["time_s"] >= since_s)
        event = next(mine, None)
        if event is None:
            break
        since_s = event["time_s"]
        found.append((f"{arm}: {words}", since_s))
    return found


def _words(name: str) -> str:
    return name.lower().replace("_", " ")
