"""The goals of trials, reached and failed, with what went wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from trocar.eval import TaskReport, in_words
from trocar.eval.trial import Trial
from trocar.report import style
from trocar.report.page import Captioned
from trocar.report.stills import photographer_of
from trocar.report.tables import figure, table_of

MOST = 12
"""Maximum number of failed goals with a picture; the page says how many more there are."""
SCALE = 0.75
"""Scale of a picture, relative to a width of 640 pixels."""


def goals_table(trials: Sequence[Trial], report: TaskReport) -> Table:
    """Return a row for each goal: for one trial how it ended and why, for several how often it was reached."""
    noun, alone = trials[0].goal_noun, len(trials) == 1
    scores = [trial.scores for trial in trials]
    goals = [[of_trial[k] for of_trial in scores if k < len(of_trial)] for k in range(max(map(len, scores)))]
    kinds = [list(dict.fromkeys(report.goal(score) for score in of_goal)) for of_goal in goals]
    which = [kind[0] if len(kind) == 1 else "" for kind in kinds]  # nothing where trials differ
    measured = list(dict.fromkeys(name for of_goal in goals for score in of_goal for name in report.measured(score)))
    rows = []
    for number, (of_goal, what) in enumerate(zip(goals, which, strict=True), start=1):
        first = of_goal[0]
        result = "done" if first["succeeded"] else in_words(str(first["failure"])) or "not done"
        rows.append(
            (
                str(number),
                *([what] if any(which) else []),
                result if alone else _how_many(of_goal),
                figure(_mean([score["end_s"] - score["start_s"] for score in of_goal])),
                *(_shown([report.measured(score).get(name) for score in of_goal]) for name in measured),
                reason_of(first, report) if alone else named_failures(of_goal),
            )
        )
    head = (noun, *(["which"] if any(which) else []), "result" if alone else "done", "time s", *measured)
    return table_of(
        (*head, "why" if alone else "failures"),
        rows,
        title=f"Each {noun}" if alone else f"Each {noun}, of {len(trials)} trials",
        caption="" if alone else "times and what was measured: means over the trials",
        right=("time s", *measured),
    )


def trials_table(trials: Sequence[Trial]) -> Table:
    """Return a row for each trial."""
    rows = []
    for trial in trials:
        attempted = [score for score in trial.scores if score["attempted"]]
        stopped = "" if trial.finished else f"stopped: {in_words(trial.ended)}"
        place = f"{trial.about['session']}, {trial.about['index']}"
        said = "; ".join(filter(None, (named_failures(attempted), stopped)))
        rows.append((place, _how_many(attempted), f"{trial.duration_s:.1f}", str(len(trial.collisions)), said))
    return table_of(
        ("session, trial", f"{trials[0].goal_noun}s done", "time s", "collisions", "failures"),
        rows,
        title="Each trial",
        caption="pictures of any of them: trocar report DIR --session S --trial K",
        right=("time s", "collisions"),
    )


def failures_table(failures: Mapping[str, int], attempted: int, goal_noun: str, report: TaskReport) -> Table:
    """Return how often each failure occurred among the goals attempted, most frequent first, and what it means."""
    of_all = f"of {attempted} {goal_noun}s"
    rows = [
        (in_words(name), str(count), sentence_of(name, report))
        for name, count in sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    ]
    return table_of(("failure", of_all, "what it means"), rows, right=(of_all,))


def reason_of(score: Mapping[str, Any], report: TaskReport) -> str:
    """Return why a goal was not reached, in a sentence if there is one; empty after a success."""
    return str(score["reason"]) or sentence_of(str(score["failure"]), report)


def sentence_of(name: str, report: TaskReport) -> str:
    """Return the sentence of an outcome of a task; empty if it has no outcome of this name."""
    outcomes = report.outcomes
    return str(outcomes[name].value) if outcomes is not None and name in outcomes.__members__ else ""


def named_failures(scores: Sequence[Mapping[str, Any]]) -> str:
    """Return how often each failure occurred among scores."""
    counts = Counter(in_words(str(score["failure"])) for score in scores if score["failure"])
    return ", ".join(f"{name} {count}" for name, count in counts.most_common())


def _how_many(scores: Sequence[Mapping[str, Any]]) -> str:
    return f"{sum(bool(score['succeeded']) for score in scores)} of {len(scores)}"


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _shown(values: Sequence[float | None]) -> str:
    """Return the mean of values as text; a single count as it is."""
    return str(values[0]) if len(values) == 1 and isinstance(values[0], int) else figure(_mean(values))


@dataclass(frozen=True)
class Failed:
    """One goal that was not reached.

    Attributes:
        place: index of its trial among the run's.
        session: of its trial.
        trial: number of its trial in the session.
        number: of the goal, from 0 on.
        failure: its name.
        what: the goal in words.
        reason: in a sentence; empty if there is none.
    """

    place: int
    session: int
    trial: int
    number: int
    failure: str
    what: str
    reason: str

    @property
    def stem(self) -> str:
        """Return the name of its picture's file."""
        return f"session_{self.session:02d}_trial_{self.trial:03d}_goal_{self.number + 1:02d}"


def failed_goals(trials: Sequence[Trial], report: TaskReport) -> list[Failed]:
    """Return all goals that were attempted and not reached, in order."""
    found = []
    for place, trial in enumerate(trials):
        session, index = trial.about["session"], trial.about["index"]
        for number, score in enumerate(trial.scores):
            if score["attempted"] and not score["succeeded"]:
                which = report.goal(score)
                what = f"{trial.goal_noun} {number + 1}" + (f" ({which})" if which else "")
                failure = str(score["failure"])
                found.append(Failed(place, session, index, number, failure, what, reason_of(score, report)))
    return found


def picked(failed: Sequence[Failed], most: int) -> list[Failed]:
    """Return those that get a picture, in order: the first of each kind of failure, then the second, and so on."""
    by_name = groupby(sorted(failed, key=lambda one: one.failure), key=lambda one: one.failure)
    in_turn = chain.from_iterable(zip_longest(*(list(group) for _, group in by_name)))
    chosen = [one for one in in_turn if one is not None][:most]
    return sorted(chosen, key=lambda one: (one.place, one.number))


def draw_failed(
    folder: str | Path, trials: Sequence[Trial], failed: Sequence[Failed], report: TaskReport, draw: bool = True
) -> list[Captioned]:
    """Draw a picture of each failed goal at the moment that shows its failure, and return them.

    Args:
        folder: for the files.
        trials: of the run.
        failed: of these, in order; each trial is read once.
        report: of the task.
        draw: False: return those that were drawn before; the simulator, which draws, is not installed.
    """
    found = []
    for place, of_trial in groupby(failed, key=lambda one: one.place):
        trial = trials[place]
        photographer = photographer_of(trial, report, SCALE) if draw else None
        for one in of_trial:
            time_s, path = report.failed_s(trial, trial.scores[one.number]), Path(folder) / f"{one.stem}.png"
            if photographer is not None:
                style.write_png(path, photographer.picture(time_s))
            elif not path.is_file():
                continue
            where = f"session {one.session}, trial {one.trial}, {one.what}: {in_words(one.failure)}"
            why = f". {one.reason[:1].upper()}{one.reason[1:]}" if one.reason else ""
            found.append(Captioned(path, f"The cell at {time_s:.1f} s: {where}", f"{where}, at {time_s:.1f} s{why}"))
    return found
