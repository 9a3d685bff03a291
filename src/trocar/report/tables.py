"""Tables of a run, its goals and trials, for the terminal and for its page, and the active flaws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from trocar.counting import counted
from trocar.eval import PaperCount, PaperRow, TaskReport, in_words
from trocar.eval.config import FITTED_ON
from trocar.eval.statistics import wilson_interval
from trocar.eval.trial import Trial


def table_of(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str = "",
    caption: str = "",
    right: Collection[str] = (),
) -> Table:
    """Return a table for the terminal and for a page (``page.table``); ``right`` names the columns of numbers."""
    table = Table(title=title, caption=caption)
    for name in head:
        table.add_column(name, justify="right" if name in right else "left")
    for row in rows:
        table.add_row(*row)
    return table


def brief_flaws(flaws: Mapping[str, str]) -> str:
    """Return the difficulty of a run's laboratory and what differs from it; ``flaws`` as in ``summary.json``."""
    if "difficulty" not in flaws:
        return "; ".join(["a real robot: its flaws are its own", *(f"{what} {how}" for what, how in flaws.items())])
    level, *named = flaws["difficulty"].split(", ")
    said = [f"difficulty {level}" + (f" except for {', '.join(named)}" if named else "")]
    said += [f"{what} {how}" for what, how in flaws.items() if how == "switched off"]
    if FITTED_ON in flaws:
        said.append(f"{FITTED_ON} {flaws[FITTED_ON]}")
    return f"laboratory: {'; '.join(said)}; summary.json has the size of every flaw"


def run_table(summary: Mapping[str, Any], paper: Sequence[PaperRow] = (), theirs: PaperCount | None = None) -> Table:
    """Return the table of a run, with published rows under it, first those of its own method.

    Args:
        summary: keys as in ``summary.json``.
        paper: rows of a paper; their intervals treat every attempt as independent, because nothing else was published.
        theirs: our run counted as in the paper, if that differs.
    """
    how_many = f"{counted(summary['trials'], 'trial')} in {counted(summary['sessions'], 'session')}"
    numbers = (summary["goal_noun"] + "s", "success", "95 % interval", "mean time s")
    table = table_of(
        ("who", *numbers),
        (),
        title=", ".join(text for text in (summary["task"], summary["variant"], how_many, where_of(summary)) if text),
        caption="intervals of our rows count sessions" + ("; the paper's count attempts" if paper else ""),
        right=numbers,
    )
    ours = _successes(summary["succeeded"], summary["attempted"], tuple(summary["success_ci95"]))
    table.add_row(f"trocar, {_method(summary)}", *ours, figure(summary["mean_time_s"]), style="bold")
    if theirs is not None:
        table.add_row(f"the same, {theirs.how}", *_successes(theirs.succeeded, theirs.attempted, theirs.ci95), "")
    if paper:
        table.add_section()
    for row in sorted(paper, key=lambda row: summary["method"] not in row.methods):
        published = _successes(row.succeeded, row.attempted, wilson_interval(row.succeeded, row.attempted))
        look = "" if summary["method"] in row.methods else "dim"
        table.add_row(f"paper: {row.who}", *published, figure(row.mean_time_s), style=look)
    return table


def where_of(summary: Mapping[str, Any]) -> str:
    """Return where a run took place, and who counted."""
    return "on a robot, as its script says" if summary.get("robot") else "simulated"


def headline(summary: Mapping[str, Any]) -> str:
    """Return a run in one sentence: how much of it succeeded, and how certain that is."""
    low, high = summary["success_ci95"]
    return (
        f"{summary['task']}, {_method(summary)}: {summary['succeeded']} of "
        f"{counted(summary['attempted'], summary['goal_noun'])}, 95 % interval {percent(low)} to {percent(high)}, in "
        f"{counted(summary['trials'], 'trial')} of {counted(summary['sessions'], 'session')}" + _who_counted(summary)
    )


def _who_counted(summary: Mapping[str, Any]) -> str:
    if not summary.get("robot"):
        return ""
    tally = summary["tally"]
    return "; the script says so, " + ("nobody counted" if tally is None else f"a person counted {tally}")


def parts_table(summary: Mapping[str, Any]) -> Table:
    """Return the time per goal, part by part."""
    parts = summary["parts_s"]
    total = sum(parts.values()) or 1.0
    rows = [
        (name, f"{seconds:z.2f}", percent(seconds / total))
        for name, seconds in sorted(parts.items(), key=lambda item: -item[1])
    ]
    title = f"Mean {summary['goal_noun']}, part by part"
    return table_of(("part", "s", "share"), rows, title=title, right=("s", "share"))


def figure(value: float | None) -> str:
    """Return a number with two decimals as text; a dash for None."""
    return "-" if value is None else f"{value:.2f}"


def percent(share: float | None) -> str:
    """Return a share in % as text; a dash for None."""
    return "-" if share is None else f"{100 * share:z.1f} %"


def _method(summary: Mapping[str, Any]) -> str:
    return f"{summary['method']} ({summary['model']})" if summary.get("model") else summary["method"]


def _successes(succeeded: int, attempted: int, interval: tuple[float, float]) -> tuple[str, str, str]:
    """Return count, rate and interval as text."""
    rate = succeeded / attempted if attempted else None
    return f"{succeeded} of {attempted}", percent(rate), f"{percent(interval[0])} to {percent(interval[1])}"


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
                result if alone else reached(of_goal),
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
        place = f"{trial.about['session']}, {trial.about['index']}"
        hits = "-" if trial.on_robot else str(len(trial.collisions))
        rows.append((place, reached(attempted), f"{trial.duration_s:.1f}", hits, came_of(trial)))
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


def goal_name(trial: Trial, number: int, report: TaskReport) -> str:
    """Return a goal's noun and number, from 1 on, and what it is."""
    which = report.goal(trial.scores[number])
    return f"{trial.goal_noun} {number + 1}" + (f" ({which})" if which else "")


def failure_counts(scores: Iterable[Mapping[str, Any]]) -> Counter[str]:
    """Return how often each failure occurred among scores, by its name."""
    return Counter(str(score["failure"]) for score in scores if score["failure"])


def named_failures(scores: Iterable[Mapping[str, Any]]) -> str:
    """Return how often each failure occurred among scores, in words."""
    return ", ".join(f"{in_words(name)} {count}" for name, count in failure_counts(scores).most_common())


def rated(rate: float, interval: Sequence[float]) -> str:
    """Return a rate in % with its interval."""
    low, high = interval
    return f"{100 * rate:.1f} [{100 * low:.0f}, {100 * high:.0f}]"


def reached(scores: Sequence[Mapping[str, Any]]) -> str:
    """Return how many of some goals were reached."""
    return f"{sum(bool(score['succeeded']) for score in scores)} of {len(scores)}"


def came_of(trial: Trial) -> str:
    """Return what failed in a trial, in words; empty if nothing did."""
    stopped = "" if trial.finished else f"stopped: {in_words(trial.ended)}"
    return "; ".join(filter(None, (named_failures([s for s in trial.scores if s["attempted"]]), stopped)))


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _shown(values: Sequence[float | None]) -> str:
    """Return the mean of values as text; a single count as it is."""
    return str(values[0]) if len(values) == 1 and isinstance(values[0], int) else figure(_mean(values))
