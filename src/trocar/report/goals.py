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
from trocar.report.picture import Picture, write_png
from trocar.report.stills import photographer_of
from trocar.report.tables import figure


def goals_table(trials: Sequence[Trial], report: TaskReport) -> Table:
    """Return a row for each goal: for one trial how it ended and why, for several how often it was reached.

    Args:
        trials: of one run.
        report: of their task.
    """
    goal_noun = trials[0].goal_noun
    scores = [trial.scores for trial in trials]
    goals = [[of_trial[k] for of_trial in scores if k < len(of_trial)] for k in range(max(map(len, scores)))]
    whats = [_same([report.goal(score) for score in of_goal]) for of_goal in goals]
    measured = list(dict.fromkeys(name for of_goal in goals for score in of_goal for name in report.measured(score)))
    alone = len(trials) == 1
    title = f"Each {goal_noun}" if alone else f"Each {goal_noun}, of {len(trials)} trials"
    table = Table(title=title, caption="" if alone else "times and what was measured: means over the trials")
    table.add_column(goal_noun)
    if any(whats):
        table.add_column("which")
    table.add_column("result" if alone else "done")
    table.add_column("time s", justify="right")
    for name in measured:
        table.add_column(name, justify="right")
    table.add_column("why" if alone else "failures")
    for number, (of_goal, what) in enumerate(zip(goals, whats, strict=True), start=1):
        table.add_row(
            str(number),
            *([what] if any(whats) else []),
            _result(of_goal[0]) if alone else _how_many(of_goal),
            figure(_mean([score["end_s"] - score["start_s"] for score in of_goal])),
            *(_shown([report.measured(score).get(name) for score in of_goal]) for name in measured),
            reason_of(of_goal[0], report) if alone else named_failures(of_goal),
        )
    return table


def trials_table(trials: Sequence[Trial]) -> Table:
    """Return a row for each trial."""
    goal_noun = trials[0].goal_noun
    table = Table(title="Each trial", caption="pictures of any of them: trocar report DIR --session S --trial K")
    for column in ("session, trial", f"{goal_noun}s done", "time s", "collisions", "failures"):
        table.add_column(column, justify="right" if column in ("time s", "collisions") else "left")
    for trial in trials:
        attempted = [score for score in trial.scores if score["attempted"]]
        stopped = "" if trial.finished else f"stopped: {in_words(trial.ended)}"
        table.add_row(
            f"{trial.about['session']}, {trial.about['index']}",
            _how_many(attempted),
            f"{trial.duration_s:.1f}",
            str(len(trial.collisions)),
            "; ".join(filter(None, (named_failures(attempted), stopped))),
        )
    return table


def failures_table(failures: Mapping[str, int], attempted: int, goal_noun: str, report: TaskReport) -> Table:
    """Return how often each failure occurred, the most frequent first, and what it means.

    Args:
        failures: counts by name, as in ``summary.json``.
        attempted: number of goals attempted.
        goal_noun: what a goal is called.
        report: of the task, which knows the outcomes' sentences.
    """
    table = Table()
    table.add_column("failure")
    table.add_column(f"of {attempted} {goal_noun}s", justify="right")
    table.add_column("what it means")
    for name, count in sorted(failures.items(), key=lambda item: (-item[1], item[0])):
        table.add_row(in_words(name), str(count), sentence_of(name, report))
    return table


def reason_of(score: Mapping[str, Any], report: TaskReport) -> str:
    """Return why a goal was not reached, in a sentence if there is one; empty after a success."""
    return str(score["reason"]) or sentence_of(str(score["failure"]), report)


def sentence_of(name: str, report: TaskReport) -> str:
    """Return the sentence of an outcome of a task; empty if it has no outcome of this name."""
    outcomes = report.outcomes
    return str(outcomes[name].value) if outcomes is not None and name in outcomes.__members__ else ""


def named_failures(scores: Sequence[Mapping[str, Any]]) -> str:
    """Return how often each failure occurred among scores."""
    counted = Counter(in_words(str(score["failure"])) for score in scores if score["failure"])
    return ", ".join(f"{name} {count}" for name, count in counted.most_common())


def _result(score: Mapping[str, Any]) -> str:
    return "done" if score["succeeded"] else in_words(str(score["failure"])) or "not done"


def _how_many(scores: Sequence[Mapping[str, Any]]) -> str:
    return f"{sum(bool(score['succeeded']) for score in scores)} of {len(scores)}"


def _same(words: Sequence[str]) -> str:
    """Return the description of the goals with a number; empty if trials differ in it."""
    return words[0] if len(set(words)) == 1 else ""


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _shown(values: Sequence[float | None]) -> str:
    """Return the mean of values as text; counts of a single trial as they are."""
    if len(values) == 1 and isinstance(values[0], int):
        return str(values[0])
    return figure(_mean(values))


MOST = 12
"""Maximum number of failed goals with a picture; the page says how many more there are."""
SCALE = 0.75
"""Scale of a picture, relative to a width of 640 pixels."""


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
        stem: of its picture's file.
    """

    place: int
    session: int
    trial: int
    number: int
    failure: str
    what: str
    reason: str
    stem: str


def failed_goals(trials: Sequence[Trial], report: TaskReport) -> list[Failed]:
    """Return all goals that were attempted and not reached, in order."""
    found = []
    for place, trial in enumerate(trials):
        for number, score in enumerate(trial.scores):
            if score["attempted"] and not score["succeeded"]:
                which = report.goal(score)
                session, index = trial.about["session"], trial.about["index"]
                found.append(
                    Failed(
                        place,
                        session,
                        index,
                        number,
                        str(score["failure"]),
                        f"{trial.goal_noun} {number + 1}" + (f" ({which})" if which else ""),
                        reason_of(score, report),
                        f"session_{session:02d}_trial_{index:03d}_goal_{number + 1:02d}",
                    )
                )
    return found


def picked(failed: Sequence[Failed], most: int) -> list[Failed]:
    """Return those that get a picture, in order: the first of each kind of failure, then the second, and so on."""
    by_name = groupby(sorted(failed, key=lambda one: one.failure), key=lambda one: one.failure)
    in_turn = chain.from_iterable(zip_longest(*(list(group) for _, group in by_name)))
    chosen = [one for one in in_turn if one is not None][:most]
    return sorted(chosen, key=lambda one: (one.place, one.number))


def draw_failed(
    folder: str | Path, trials: Sequence[Trial], failed: Sequence[Failed], report: TaskReport, draw: bool = True
) -> list[Picture]:
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
                write_png(path, photographer.picture(time_s))
            elif not path.is_file():
                continue
            where = f"session {one.session}, trial {one.trial}, {one.what}: {in_words(one.failure)}"
            why = f". {one.reason[:1].upper()}{one.reason[1:]}" if one.reason else ""
            found.append(Picture(path, f"The cell at {time_s:.1f} s: {where}", f"{where}, at {time_s:.1f} s{why}"))
    return found
