"""The summary of a run, from its saved trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trocar.errors import TrocarError
from trocar.report.driven import driven_summary
from trocar.report.statistics import Spread, wilson_interval
from trocar.trials.trial import Trial

PARTS = {
    "peg-transfer": ("capture", "perception", "planning", "motion", "jaw", "settling"),
    "suture": ("planning", "loading", "motion", "jaw", "settling"),
}
"""Spans that the time of a transfer or suture is made of, by task; what is left is ``other``."""

COLLIDES = ("peg-transfer",)
"""Tasks whose referee looks for collisions; the phantom of sutures is solid to nothing."""

MORE = {"suture": driven_summary}
"""What tasks add to the summary."""

MISSED_WARNING = 0.01
"""A run says so when more than this share of computations took longer than the trial's clock counted."""


def summarise(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the content of ``summary.json`` (keys: docs, "Files of a run"); times of an empty run are None.

    ``mean_time_s`` is the completion time over the number of transfers, as in the paper's tables; ``parts_s`` adds
    up to it.
    """
    if not trials:
        raise TrocarError("there are no finished trials to summarise; run some with `trocar run`")
    about = trials[0].about
    more = MORE.get(str(about["task"]))
    transfers = [transfer for trial in trials for transfer in trial.transfers]
    attempted = [transfer for transfer in transfers if transfer["attempted"]]
    succeeded = sum(bool(transfer["succeeded"]) for transfer in attempted)
    total_s = sum(trial.duration_s for trial in trials)
    count = len(attempted)
    compute, missed = _compute(trials)
    wall_s = sum(trial.wall_s for trial in trials)
    return {
        "task": about["task"],
        "variant": about["variant"],
        "method": about["method"],
        "model": about["model"] if about["method"] == "calibrated" else None,
        "seed": about["seed"],
        "trials": len(trials),
        "attempted": count,
        "succeeded": succeeded,
        "success_rate": succeeded / count if count else None,
        "success_ci95": list(wilson_interval(succeeded, count)),
        "complete_trials": sum(_complete(trial) for trial in trials),
        "mean_time_s": total_s / count if count else None,
        "completion_time_s": {
            "mean": Spread.of([trial.duration_s for trial in trials]).mean,
            "sd": Spread.of([trial.duration_s for trial in trials]).sd if len(trials) > 1 else None,
        },
        "parts_s": _parts(trials, count),
        "collisions_per_trial": _collisions(trials),
        "failures": dict(Counter(str(transfer["failure"]) for transfer in attempted if transfer["failure"])),
        "compute_ms": compute,
        "missed_budgets": missed,
        "realtime_factor": total_s / wall_s if wall_s else None,
        "cables": about["cables"],
        "versions": about["versions"],
        **(more(trials) if more else {}),
    }


def _collisions(trials: Sequence[Trial]) -> float | None:
    """Return the mean number; None for a task whose referee looks for none."""
    if trials[0].about["task"] not in COLLIDES:
        return None
    return sum(len(trial.collisions) for trial in trials) / len(trials)


def _complete(trial: Trial) -> bool:
    """Return whether all succeeded: twelve transfers, which is the paper's successful trial, or all sutures."""
    pieces = trial.about.get("sutures") or 12
    return len(trial.transfers) == pieces and all(transfer["succeeded"] for transfer in trial.transfers)


def _parts(trials: Sequence[Trial], transfers: int) -> dict[str, float]:
    """Return the mean time a transfer of each part; they add up to the mean transfer time."""
    if not transfers:
        return {}
    seconds: dict[str, float] = {name: 0.0 for name in PARTS[str(trials[0].about["task"])]}
    for trial in trials:
        for span in trial.spans:
            seconds[span.name] = seconds.get(span.name, 0.0) + span.end_s - span.start_s
    total = sum(trial.duration_s for trial in trials)
    parts = {name: value / transfers for name, value in seconds.items()}
    parts["other"] = total / transfers - sum(parts.values())
    return parts


def _compute(trials: Sequence[Trial]) -> tuple[dict[str, Mapping[str, float]], float]:
    """Return p50 and p95 of each computation in ms, and the share that took longer than its budget."""
    times: dict[str, list[float]] = {}
    missed = total = 0
    for trial in trials:
        for computation in trial.computations:
            times.setdefault(computation.name, []).append(1e3 * computation.seconds)
            missed += computation.seconds > computation.budget_s
            total += 1
    spread = {name: np.percentile(values, [50, 95]) for name, values in times.items()}
    return {name: {"p50": float(p[0]), "p95": float(p[1])} for name, p in spread.items()}, missed / max(total, 1)
