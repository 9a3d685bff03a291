"""The summary of a run, from its saved trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trocar.errors import InvalidInput
from trocar.eval import TaskReport
from trocar.eval.statistics import by_session, session_interval
from trocar.eval.trial import Trial
from trocar.eval.trials import noted
from trocar.notebook import table
from trocar.report.tables import failure_counts
from trocar.report.timechart import OTHER, parts_of

MISSED_WARNING = 0.01
"""A run warns when more than this share of computations took longer than the trial's clock counted."""


class Summary(dict[str, Any]):
    """The content of ``summary.json``; a dict that a notebook shows as a line and a table."""

    def __repr__(self) -> str:
        what = " ".join(str(self[key]) for key in ("task", "variant", "method") if self[key])
        low, high = self["success_ci95"]
        each = "" if self["mean_time_s"] is None else f", {self['mean_time_s']:.2f} s each"
        return (
            f"<Summary of {what}: {self['succeeded']} of {self['attempted']} {self['goal_noun']}s "
            f"(95 % interval {100 * low:.0f} to {100 * high:.0f} %){each}; {self['trials']} trials in "
            f"{self['sessions']} sessions>"
        )

    def _repr_html_(self) -> str:
        plain = ((key, value) for key, value in self.items() if not isinstance(value, Mapping | list))
        rows = ((key, f"{value:.4g}" if isinstance(value, float) else value) for key, value in plain)
        return table(self, ("key", "value"), rows)


def summarise(trials: Sequence[Trial], report: TaskReport | None = None) -> Summary:
    """Return the content of ``summary.json`` (keys: docs, "Files of a run").

    ``mean_time_s`` is the completion time over the number of goals, as in the paper's tables; ``parts_s`` adds up to
    it, averaged over the working arms. Without attempted goals, it and ``success_rate`` are None. ``report`` is what
    the task adds.
    """
    if not trials:
        raise InvalidInput("there", "are no finished trials to summarise", "run some with `trocar run`")
    report = report or TaskReport()
    added = report.summary(trials)
    trials = noted(trials)
    about, robot = trials[0].about, trials[0].on_robot
    attempted = [score for trial in trials for score in trial.scores if score["attempted"]]
    done, count = sum(bool(score["succeeded"]) for score in attempted), len(attempted)
    succeeded_in = by_session(trials, lambda t: sum(bool(s["attempted"] and s["succeeded"]) for s in t.scores))
    attempted_in = by_session(trials, lambda t: sum(bool(s["attempted"]) for s in t.scores))
    total_s = sum(trial.duration_s for trial in trials)
    wall_s = sum(trial.wall_s for trial in trials)
    compute, missed = _compute(trials)
    use = np.max([share for trial in trials for share in trial.command_limit_use.values()], axis=0).tolist()
    speeds = [trial.machine_speed for trial in trials if trial.computations]
    durations_s = [trial.duration_s for trial in trials]
    return Summary(
        {
            **{key: about[key] for key in ("task", "variant", "station", "method", "model", "planner", "seed")},
            "goal_noun": about["goal_noun"],
            "sessions": len(attempted_in),
            "trials": len(trials),
            "attempted": count,
            "succeeded": done,
            "success_rate": done / count if count else None,
            "success_ci95": list(session_interval(*([*map(sum, of.values())] for of in (succeeded_in, attempted_in)))),
            "complete_trials": sum(  # what the paper calls a successful trial
                bool(trial.scores) and all(score["succeeded"] for score in trial.scores) for trial in trials
            ),
            "mean_time_s": total_s / count if count else None,
            "completion_time_s": {
                "mean": float(np.mean(durations_s)),
                "sd": float(np.std(durations_s, ddof=1)) if len(trials) > 1 else None,
            },
            "parts_s": _parts(trials, count, report.parts),
            "collisions_per_trial": None if robot else sum(len(trial.collisions) for trial in trials) / len(trials),
            "failures": dict(failure_counts(attempted)),
            "command_limit_use": {"velocity": use[0], "acceleration": use[1]},
            "compute_ms": compute,
            "missed_budgets": missed,
            "machine_speed": float(np.mean(speeds)) if speeds else None,
            "realtime_factor": total_s / wall_s if wall_s else None,
            "flaws": about["flaws"],
            "versions": about["versions"],
            "fingerprint": about["fingerprint"],
            **({"robot": about["robot"], "tally": _tally(trials)} if robot else {}),
            **added,
        }
    )


def _tally(trials: Sequence[Trial]) -> int | None:
    """Return how many goals a person counted; None unless somebody did in every trial."""
    counts = [trial.about.get("tally") for trial in trials]
    return sum(counts) if all(isinstance(count, int) for count in counts) else None  # type: ignore[arg-type]


def _parts(trials: Sequence[Trial], count: int, order: Sequence[str]) -> dict[str, float]:
    """Return the mean time per goal of each part, over the arms that worked."""
    if not count:
        return {}
    seconds: dict[str, float] = {name: 0.0 for name in order}
    for trial in trials:
        arms = trial.about["arms"]
        for arm in arms:
            for name, part_s in parts_of(trial.spans, arm, trial.duration_s).items():
                seconds[name] = seconds.get(name, 0.0) + part_s / len(arms)
    other = seconds.pop(OTHER)
    return {name: value / count for name, value in seconds.items()} | {OTHER: other / count}


def _compute(trials: Sequence[Trial]) -> tuple[dict[str, Mapping[str, float]], float]:
    """Return p50 and p95 of each computation in ms, and the share that took longer than its budget.

    Both are converted to the machine for which the budgets were declared.
    """
    times: dict[str, list[float]] = {}
    missed = total = 0
    for trial in trials:
        for computation in trial.computations:
            seconds = computation.seconds * trial.machine_speed
            times.setdefault(computation.name, []).append(1e3 * seconds)
            missed += seconds > computation.budget_s
            total += 1
    spread = {name: np.percentile(values, [50, 95]) for name, values in times.items()}
    return {name: {"p50": float(p[0]), "p95": float(p[1])} for name, p in spread.items()}, missed / max(total, 1)
