"""Suture plans and the paper's Table I as tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table


def _table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], text: int = 1) -> Table:
    """Return a table whose first ``text`` columns are text, and the others numbers."""
    table = Table(title=title)
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number < text else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def plan_table(summary: Mapping[str, Any]) -> Table:
    """Return the sutures of a plan: position, direction, distance of the joints from their limits, reward.

    Args:
        summary: as ``plan_summary`` returns it.
    """
    table = Table(title=f"{len(summary['positions_deg'])} sutures by {summary['arm']}")
    table.add_column("theta deg", justify="right", no_wrap=True)
    table.add_column("direction", no_wrap=True)
    names = list(summary["joint_room"][0])
    shown = names if summary["joints"] == "all" else names[3:]
    for name in shown:
        joint, _, unit = name.rpartition("_")
        table.add_column(f"{joint.replace('_', ' ')} left, {unit}", justify="right")
    table.add_column("reward", justify="right", no_wrap=True)
    columns = (summary[key] for key in ("positions_deg", "direction_names", "joint_room", "rewards"))
    for theta, direction, left, value in zip(*columns, strict=True):
        table.add_row(
            f"{theta:.4g}",
            direction.replace("counterclockwise", "counterclockw."),
            *("-" if left[name] is None else f"{left[name]:.1f}" for name in shown),
            f"{value:.4f}",
            style="bold" if value == min(summary["rewards"]) else None,
        )
    return table


def points_table(points: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return Table I beside the paper's; 100 is the best plan of each.

    Args:
        points: entries by location and allowed directions.
        paper: the same as printed in the paper.
    """
    rows = [
        (location, allowed, f"{ours:.1f}", f"{paper[location][allowed]:.1f}", f"{ours - paper[location][allowed]:+.1f}")
        for location, row in points.items()
        for allowed, ours in row.items()
    ]
    columns = ("location", "directions", "ours", "paper", "difference")
    return _table("Table I: points, the best plan 100", columns, rows, text=2)


def gains_table(gains: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return the gain of the best plan over baselines, in points and as a ratio, ours and from the paper's table.

    Args:
        gains: ``points`` and ``ratio_percent`` by baseline.
        paper: the same from the paper's Table I; its text calls the points percent.
    """
    table = Table(title="Gain of the best plan")
    table.add_column("over")
    for column in ("points", "paper", "ratio", "paper"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, ours in gains.items():
        both = (ours, paper[name])
        ratios = ("-" if gain["ratio_percent"] is None else f"{gain['ratio_percent']:.1f} %" for gain in both)
        table.add_row(name, *(f"{gain['points']:.1f}" for gain in both), *ratios)
    return table


def sweep_table(sweep: Mapping[str, Any]) -> Table:
    """Return where the best plan starts at each lambda (Fig. 7).

    Args:
        sweep: ``LambdaSweep.summary()``.
    """
    row = ("theta", *(f"{angle:.4g}" for angle in sweep["best_theta_deg"]))
    columns = ("lambda", *(f"{weight:g}" for weight in sweep["weights"]))
    return _table("Fig. 7: theta of the first suture, deg, of the best plan at each lambda", columns, [row])


def setup_table(free: Sequence[Mapping[str, Any]]) -> Table:
    """Return the parameters of a setup that were searched over.

    Args:
        free: ``name`` with its unit, ``from``, ``to``, ``low`` and ``high`` of each parameter.
    """
    rows = [
        (number["name"].replace("_", " "), *(f"{number[key]:.1f}" for key in ("from", "to", "low", "high")))
        for number in free
    ]
    return _table("The best setup found", ("parameter", "preset", "found", "from", "to"), rows)
