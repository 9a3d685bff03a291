"""The outcome of each goal and of each trial, in tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from trocar.eval import TaskReport, in_words
from trocar.eval.trial import Trial
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
