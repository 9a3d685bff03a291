"""Trials in numbers, and the figures of Table I from them, with 95 % intervals that count sessions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.eval.comparison import ratio_estimate, session_estimate
from trocar.eval.statistics import by_session, session_interval
from trocar.report.timechart import parts_of
from trocar.tasks.debridement.report.table_one import MODES, PARTS

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

COUNTED = {
    **dict.fromkeys(("capture", "perception", "settling"), "perception"),
    "planning": "planning",
    **dict.fromkeys(("motion", "jaw"), "motion"),
}
"""Part of Table I for which a span counts. Everything else is waiting: for the other arm, its token or its plan, for
the camera or, if an arm notes nothing, with nothing left to do."""

OF_FRAGMENTS = ("fragment_false_negatives", "fragment_false_positives")
"""Modes that are counted per fragment, each at most once; the others are counted per attempt."""


@dataclass(frozen=True)
class Row:
    """One trial."""

    fingerprint: str  # of its run
    session: int  # number
    index: int  # of the trial in its session
    fragments: int  # their number
    cleared: int  # how many were cleared
    first_attempts: int  # how many at the first attempt, without any failure on the way
    attempts: int  # closings of jaws, at all fragments
    recoveries: int  # failures of grasping or movement after which the fragment was still cleared
    duration_s: float  # of the whole trial
    parts_s: dict[str, float]  # by part of Table I, mean of the working arms; they add up to the duration
    plans: int  # requested by all arms
    modes: dict[str, list[int]]  # how often each failure mode occurred, and out of how many fragments or attempts
    collisions: int  # contacts of arms with the receptacle, the table and each other
    ended: str  # ``done``, or what stopped the script
    failures: dict[str, int]  # names of the outcomes of fragments that were not cleared, with their number
    wall_s: float  # real time of the trial; 0 if it was lost


def row_of(trial: Trial) -> Row:
    """Return a trial's row."""
    scores = trial.scores
    return Row(
        fingerprint=trial.about["fingerprint"],
        session=trial.about["session"],
        index=trial.about["index"],
        fragments=len(scores),
        cleared=sum(bool(score["succeeded"]) for score in scores),
        first_attempts=sum(bool(score["first_attempt"]) for score in scores),
        attempts=sum(score["attempts"] for score in scores),
        recoveries=sum(score["recoveries"] for score in scores),
        duration_s=trial.duration_s,
        parts_s=_parts(trial),
        plans=sum(span.name == "planning" for span in trial.spans),
        modes={
            mode: [sum(pair) for pair in zip(*(_counted(score, mode) for score in scores), strict=True)] or [0, 0]
            for mode in MODES
        },
        collisions=len(trial.collisions),
        ended=trial.ended,
        failures=dict(Counter(str(score["failure"]) for score in scores if score["failure"])),
        wall_s=trial.wall_s,
    )


def _counted(score: Mapping[str, Any], mode: str) -> tuple[int, int]:
    """Return how often a mode occurred, and how often it could have."""
    of = 1 if mode in OF_FRAGMENTS else score["attempts"]
    return min(score[mode], of), of


def _parts(trial: Trial) -> dict[str, float]:
    seconds: dict[str, float] = dict.fromkeys(PARTS, 0.0)
    arms = trial.about["arms"]
    for arm in arms:
        for name, part_s in parts_of(trial.spans, arm, trial.duration_s).items():
            seconds[COUNTED.get(name, "waiting")] += part_s / len(arms)
    return seconds


def figures_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of Table I as JSON values.

    Times per fragment are the trials' durations over the fragments that were cleared; None if there are none.
    """
    cleared = sum(row.cleared for row in rows)
    seconds = {part: sum(row.parts_s[part] for row in rows) for part in PARTS}
    total_s = sum(seconds.values())
    failures = sum((Counter(row.failures) for row in rows), Counter[str]())
    contacts = session_estimate(by_session(rows, lambda row: float(row.collisions)))
    return {
        "fragments": sum(row.fragments for row in rows),
        "cleared": cleared,
        "cleared_rate": rate_of(rows, lambda row: (row.cleared, row.fragments)),
        "s_per_fragment": _per_fragment(rows, lambda row: row.duration_s),
        "table_parts_s": {part: s / cleared if cleared else None for part, s in seconds.items()},
        "table_parts_share": {part: s / total_s if total_s else None for part, s in seconds.items()},
        "replans_per_fragment": _per_fragment(rows, lambda row: float(row.plans)),
        "failure_modes": {mode: rate_of(rows, lambda row, mode=mode: row.modes[mode]) for mode in MODES},
        "first_attempt": rate_of(rows, lambda row: (row.first_attempts, row.fragments)),
        "attempts": sum(row.attempts for row in rows),
        "recoveries": sum(row.recoveries for row in rows),
        "contacts_per_trial": asdict(contacts.not_negative()),
        "unfinished_trials": sum(row.ended != "done" for row in rows),
        "left_behind": dict(failures),
        "wall_s_per_trial": float(np.mean([row.wall_s for row in rows])),
    }


def rate_of(rows: Sequence[Row], counts: Callable[[Row], Sequence[int]]) -> dict[str, Any]:
    """Return a rate with its interval; ``counts`` gives a trial's number of events, and out of how many."""
    pairs = [np.sum(values, axis=0) for values in by_session(rows, counts).values()]
    count, of = (int(sum(pair[k] for pair in pairs)) for k in (0, 1))
    return {
        "count": count,
        "of": of,
        "rate": count / of if of else None,
        "ci95": list(session_interval(*([int(pair[k]) for pair in pairs] for k in (0, 1)))),
    }


def _per_fragment(rows: Sequence[Row], value: Callable[[Row], float]) -> dict[str, Any] | None:
    found = ratio_estimate(by_session(rows, lambda row: (value(row), row.cleared)))
    return None if found is None else asdict(found.not_negative())
