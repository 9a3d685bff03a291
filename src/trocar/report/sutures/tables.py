"""Suture plans and the paper's Table I as tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

SHORT = {"clockwise": "clockwise", "counterclockwise": "counterclockw."}


def plan_table(summary: Mapping[str, Any]) -> Table:
    """Return the sutures of a plan: where, which way, how far the joints stay from their limits, worth.

    Args:
        summary: as ``plan_summary`` returns it.
    """
    table = Table(title=f"{len(summary['positions_deg'])} sutures by {summary['arm']}")
    table.add_column("theta deg", justify="right", no_wrap=True)
    table.add_column("direction", no_wrap=True)
    names = list(summary["joint_room"][0]) if summary["joint_room"] else []
    shown = names if summary["joints"] == "all" else names[3:]
    for name in shown:
        table.add_column(f"{name.rsplit('_', 1)[0].replace('_', ' ')} left, {name.rsplit('_', 1)[1]}", justify="right")
    table.add_column("reward", justify="right", no_wrap=True)
    worst = min(summary["rewards"])
    for theta, direction, left, value in zip(
        summary["positions_deg"],
        summary["direction_names"],
        summary["joint_room"],
        summary["rewards"],
        strict=True,
    ):
        table.add_row(
            f"{theta:.4g}",
            SHORT[direction],
            *("-" if left[name] is None else f"{left[name]:.1f}" for name in shown),
            f"{value:.4f}",
            style="bold" if value == worst else None,
        )
    return table


def points_table(points: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return Table I beside the paper's: 100 is the best plan of each.

    Args:
        points: by location and allowed directions.
        paper: the same, printed in the paper.
    """
    table = Table(title="Table I: points, the best plan 100")
    for column in ("location", "directions"):
        table.add_column(column, no_wrap=True)
    for column in ("ours", "paper", "difference"):
        table.add_column(column, justify="right", no_wrap=True)
    for location, row in points.items():
        for allowed, value in row.items():
            printed = paper[location][allowed]
            table.add_row(location, allowed, f"{value:.1f}", f"{printed:.1f}", f"{value - printed:+.1f}")
    return table
