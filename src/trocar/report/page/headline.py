"""What a reader wants first: success, time, collisions, and reasons to doubt them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from trocar.report.summary import MISSED_WARNING
from trocar.report.tables import percent


def headline(summary: Mapping[str, Any]) -> str:
    """Return success with its interval, time and collisions as HTML.

    Args:
        summary: keys as in ``summary.json``.
    """
    piece, sessions = summary["goal_noun"], summary["sessions"]
    low, high = summary["success_ci95"]
    whole = summary["completion_time_s"]
    spread = "" if whole["sd"] is None else f" ± {whole['sd']:.1f} (SD)"
    mean_s = summary["mean_time_s"]
    cards = (
        (
            f"{piece}s done",
            f"{summary['succeeded']} of {summary['attempted']}",
            f"{percent(summary['success_rate'])}, 95 % interval {100 * low:.1f} to {percent(high)}, counting "
            f"{sessions} session{'' if sessions == 1 else 's'}",
        ),
        (
            f"mean time of a {piece}",
            "-" if mean_s is None else f"{mean_s:.2f} s",
            f"a whole trial: {whole['mean']:.1f}{spread} s",
        ),
        (
            "collisions per trial",
            f"{summary['collisions_per_trial']:.2f}",
            f"{summary['trials']} trial{'' if summary['trials'] == 1 else 's'}",
        ),
        (
            "complete trials",
            f"{summary['complete_trials']} of {summary['trials']}",
            f"in which every {piece} succeeded",
        ),
    )
    inside = "".join(
        f"<div><dt>{escape(what)}</dt><dd class=figure>{escape(value)}</dd><dd class=quiet>{escape(more)}</dd></div>"
        for what, value, more in cards
    )
    return f"<dl class=headline>{inside}</dl>"


def warnings(summary: Mapping[str, Any]) -> Sequence[str]:
    """Return reasons to doubt the figures."""
    if summary["missed_budgets"] <= MISSED_WARNING:
        return []
    return [
        f"{percent(summary['missed_budgets'])} of computations took longer than the trial's clock counted for them: "
        "on the machine that ran this, a real arm would have waited."
    ]
