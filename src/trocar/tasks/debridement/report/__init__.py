"""Moments, tables and pictures of debridement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from trocar.eval import PaperRow, TaskReport, in_words, stopped
from trocar.replay import Viewpoint
from trocar.tasks.debridement.goals import FragmentOutcome
from trocar.tasks.debridement.report.charts import draw_failures
from trocar.tasks.debridement.report.figures import figures_of, row_of
from trocar.tasks.debridement.report.table_one import PERSON, TABLE_1, table_one

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

ROOM_M, ABOVE_M = 0.012, 0.035
"""Margin round a fragment, and above it and the receptacle's floor, in a picture's frame."""

MAX_FAILURES = 3  # maximum number of failures noted by a script that get a picture

APART_S = 0.5  # anything earlier than this looks like the start

STEPS = {"closing": "jaws open round it", "pickup": "lifted, and looked at", "releasing": "over the receptacle"}
"""Events of the first grasp, in order, with their captions."""

ASSUMED = (
    "s per fragment is the trials' duration over the fragments that were cleared, as in Table I, where all were",
    "time by part is the mean of the working arms, each moment counted once: perception with capture and settling, "
    "motion with jaws; waiting is everything else, including an arm with nothing left to do",
    "replans: how often an arm asked for a plan, whether or not one was found",
    "fragment false negatives and positives are counted per fragment, each once; the other modes per attempt, that "
    "is, per closing of the jaws. The paper does not say what its rates are fractions of",
    "assumed: size and weight of fragments, static cling of a quarter of them, latency of camera and computations, the "
    "arms' error field (drawn as large as one recording shows), places where arms rest",
)


class DebridementReport(TaskReport):
    """What a report of debridement adds."""

    view = Viewpoint((-0.0745, 0.36, 0.20))
    outcomes = FragmentOutcome
    captions: Mapping[str, str] = {
        "failures": "The nine failure modes, ours beside the paper's; bars are rates, whiskers 95 % intervals"
    }
    parts = ("capture", "perception", "planning", "motion", "jaw", "settling", "waiting")

    def frame(self, trial: Trial) -> NDArray[np.float64]:
        """Return corners (n, 3) of boxes round the fragments at the start and the receptacle, with space above."""
        walls = [solid for solid in trial.scenery.solids if solid.body == "receptacle"]
        half = np.max([np.abs(w.T_body_solid.translation_m) + w.size_m for w in walls], axis=0)
        middle = trial.scenery.T_world_body["receptacle"].translation_m
        lay = [array[0, :3].astype(np.float64) for name, array in trial.arrays.items() if name.startswith("body_")]
        places = [(middle, half), *((p, np.full(3, ROOM_M)) for p in lay)]
        corners = np.array([(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)])
        tops = [(p, corners * half[:2], z) for p, half in places for z in (0.0, ABOVE_M)]
        return np.concatenate([p + np.column_stack([flat, np.full(4, z)]) for p, flat, z in tops])

    def measured(self, score: Mapping[str, Any]) -> Mapping[str, float | None]:
        """Return how often jaws closed on a fragment, and how many failures were recovered."""
        return {"attempts": score["attempts"], "recoveries": score["recoveries"]}

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the moments of the start, the first grasp step by step, each cleared fragment, failures, the end."""
        grasp = _first_grasp(trial)
        found = [("start", 0.0), *(moment for moment in grasp if moment[1] >= APART_S)]
        cleared = [score for score in trial.scores if score["succeeded"]]
        found += [(f"fragment {k} in the receptacle", score["end_s"]) for k, score in enumerate(cleared, start=1)]
        failed = [e for e in trial.events if e["name"] == "fragment" and e["outcome"] != FragmentOutcome.DONE.name]
        found += [(f"{e['arm']}: {in_words(e['outcome'])}", e["time_s"]) for e in failed[:MAX_FAILURES]]
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
        """Return the columns of Table I for this number of arms and for the person; both cleared all (VI-A)."""
        columns = ((TABLE_1[summary["variant"]], (str(summary["method"]),)), (PERSON, ()))
        return [PaperRow(c.who, c.s_per_fragment, c.fragments, c.fragments, methods) for c, methods in columns]

    def tables(self, summary: Mapping[str, Any]) -> list[Table]:
        """Return Table I."""
        variant, method = summary["variant"], summary["method"]
        return [table_one(variant, summary["table_1"], f"Table I, {variant.replace('-', ' ')}, {method}")]

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what stopped a trial, and what is counted and assumed."""
        return [*filter(None, (stopped(trial.events)[1] for trial in trials)), *ASSUMED]


def _first_grasp(trial: Trial) -> list[tuple[str, float]]:
    """Return the steps of the first grasp: when its arm claimed a fragment, closed, looked and let go."""
    given = next((event for event in trial.events if event["name"] == "allocated"), None)
    if given is None:
        return []
    arm, since_s = given["arm"], given["time_s"]
    found = [(f"{arm} goes for a fragment", since_s)]
    for name, words in STEPS.items():
        later = (e["time_s"] for e in trial.events if e["name"] == name and e.get("arm") == arm)
        at_s = next((time_s for time_s in later if time_s >= since_s), None)
        if at_s is None:
            break
        since_s = at_s
        found.append((f"{arm}: {words}", at_s))
    return found
