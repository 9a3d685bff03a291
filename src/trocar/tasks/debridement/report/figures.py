"""Table I from the rows of trials, with 95 % intervals that count sessions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from trocar.eval.comparison import ratio_estimate, session_estimate
from trocar.eval.statistics import session_interval
from trocar.tasks.debridement.report.published import MODES, PARTS
from trocar.tasks.debridement.report.row import Row


def figures_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of Table I as JSON values.

    Times per fragment are the trials' durations over the fragments that were cleared; None if there are none.
    """
    cleared = sum(row.cleared for row in rows)
    seconds = {part: sum(row.parts_s[part] for row in rows) for part in PARTS}
    total_s = sum(seconds.values())
    failures: Counter[str] = Counter()
    for row in rows:
        failures.update(row.failures)
    return {
        "fragments": sum(row.fragments for row in rows),
        "cleared": cleared,
        "cleared_rate": rate_of(rows, lambda row: (row.cleared, row.fragments)),
        "s_per_fragment": _per_fragment(rows, lambda row: row.duration_s),
        "table_parts_s": {part: s / cleared if cleared else None for part, s in seconds.items()},
        "table_parts_share": {part: s / total_s if total_s else None for part, s in seconds.items()},
        "replans_per_fragment": _per_fragment(rows, lambda row: float(row.plans)),
        "failure_modes": {mode: rate_of(rows, _mode(mode)) for mode in MODES},
        "first_attempt": rate_of(rows, lambda row: (row.first_attempts, row.fragments)),
        "attempts": sum(row.attempts for row in rows),
        "recoveries": sum(row.recoveries for row in rows),
        "contacts_per_trial": asdict(session_estimate(by_session(rows, lambda row: float(row.collisions)))),
        "unfinished_trials": sum(row.ended != "done" for row in rows),
        "left_behind": dict(failures),
        "wall_s_per_trial": float(np.mean([row.wall_s for row in rows])),
    }


def by_session(rows: Sequence[Row], value: Callable[[Row], Any]) -> dict[int, list[Any]]:
    """Return one value per trial, by session."""
    found: dict[int, list[Any]] = {}
    for row in rows:
        found.setdefault(row.session, []).append(value(row))
    return found


def rate_of(rows: Sequence[Row], counts: Callable[[Row], Sequence[int]]) -> dict[str, Any]:
    """Return a rate with its interval over sessions.

    Args:
        rows: of trials.
        counts: how often something occurred in a trial, and out of how many.
    """
    pairs = [np.sum(values, axis=0) for values in by_session(rows, counts).values()]
    count, of = (int(sum(pair[k] for pair in pairs)) for k in (0, 1))
    return {
        "count": count,
        "of": of,
        "rate": count / of if of else None,
        "ci95": list(session_interval(*([int(pair[k]) for pair in pairs] for k in (0, 1)))),
    }


def _mode(mode: str) -> Callable[[Row], Sequence[int]]:
    return lambda row: row.modes[mode]


def _per_fragment(rows: Sequence[Row], value: Callable[[Row], float]) -> dict[str, Any] | None:
    found = ratio_estimate(by_session(rows, lambda row: (value(row), row.cleared)))
    return None if found is None else asdict(found)
