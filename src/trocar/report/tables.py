"""A run beside the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from trocar.report.statistics import wilson_interval


@dataclass(frozen=True)
class PaperFigure:
    """One row of the paper's Tables II-IV.

    Attributes:
        who: the condition.
        mean_time_s: mean transfer time.
        succeeded: transfers.
        attempted: transfers; the uncalibrated robot and some volunteers lost blocks and attempted fewer than all.
    """

    who: str
    mean_time_s: float
    succeeded: int
    attempted: int


PAPER: dict[str, tuple[PaperFigure, ...]] = {
    "unilateral": (
        PaperFigure("volunteers", 12.3, 610, 636),
        PaperFigure("surgeon", 4.7, 120, 120),
        PaperFigure("robot, uncalibrated", 5.6, 26, 75),
        PaperFigure("robot, calibrated", 5.7, 120, 120),
        PaperFigure("robot, calibrated and optimised", 5.2, 120, 120),
    ),
}
"""Hwang et al. 2022, Table II, by variant."""


NAMES = {"peg-transfer": "transfer", "suture": "suture"}
"""What a task is made of, by task."""


def run_table(summary: Mapping[str, Any]) -> Table:
    """Return the table of a run, with the paper's rows of the same variant under it.

    Args:
        summary: keys as in ``summary.json``: task, variant, method, trials, attempted, succeeded,
            mean_time_s.
    """
    trials = f"{summary['trials']} trial{'s' if summary['trials'] != 1 else ''}"
    table = Table(title=f"{summary['task']}, {summary['variant']}, {trials}, simulated")
    table.add_column("who")
    for column in (NAMES[summary["task"]] + "s", "success", "95 % interval", "mean time s"):
        table.add_column(column, justify="right")
    model = f" ({summary['model']})" if summary.get("model") else ""
    table.add_row(
        f"trocar, {summary['method']}{model}",
        *_successes(summary["succeeded"], summary["attempted"]),
        _seconds(summary["mean_time_s"]),
        style="bold",
    )
    rows = PAPER.get(summary["variant"], ())
    if rows:
        table.add_section()
    for row in rows:
        table.add_row(
            f"paper: {row.who}",
            *_successes(row.succeeded, row.attempted),
            _seconds(row.mean_time_s),
            style="dim",
        )
    return table


def _successes(succeeded: int, attempted: int) -> tuple[str, str, str]:
    """Return count, rate and Wilson interval as text."""
    low, high = wilson_interval(succeeded, attempted)
    rate = succeeded / attempted if attempted else None
    return f"{succeeded} of {attempted}", _percent(rate), f"{_percent(low)} to {_percent(high)}"


def parts_table(summary: Mapping[str, Any]) -> Table:
    """Return where a transfer's time went, part by part."""
    table = Table(title=f"Mean {NAMES[summary['task']]}, part by part")
    table.add_column("part")
    table.add_column("s", justify="right")
    table.add_column("share", justify="right")
    parts = summary["parts_s"]
    total = sum(parts.values()) or 1.0
    for name, seconds in sorted(parts.items(), key=lambda item: -item[1]):
        table.add_row(name, f"{seconds:z.2f}", _percent(seconds / total))
    return table


def driven_table(summary: Mapping[str, Any]) -> Table:
    """Return how far driven joints and needle were from the plan (task suture)."""
    table = Table(title=f"Driven against planned, {summary['method']}")
    table.add_column("what")
    table.add_column("RMS", justify="right")
    table.add_column("largest", justify="right")
    for joint, error in summary["joint_error_deg"].items():
        table.add_row(f"{joint.replace('_', ' ')}, deg", _figure(error["rms"]), _figure(error["max"]))
    insertion, tip = summary["insertion_error_mm"], summary["tip_error_mm"]
    table.add_row("insertion, mm", _figure(insertion["rms"]), _figure(insertion["max"]))
    table.add_row("needle's tip off its path, mm", _figure(tip["rms"]), _figure(tip["max"]))
    for end in ("entry", "exit"):
        table.add_row(f"{end} off its point, mm", "", _figure(summary[f"{end}_error_mm"]["max"]))
    table.add_row("slip in the jaws, mm", "", _figure(summary["slip_mm"]["max"]))
    return table


def _figure(value: float | None) -> str:
    """Return a number as text, a dash where there is none."""
    return "-" if value is None else f"{value:.2f}"


def _percent(share: float | None) -> str:
    """Return a share as text, a dash where there is none."""
    return "-" if share is None else f"{100 * share:z.1f} %"


def _seconds(time_s: float | None) -> str:
    """Return a time as text, a dash where there is none."""
    return "-" if time_s is None else f"{time_s:.2f}"
