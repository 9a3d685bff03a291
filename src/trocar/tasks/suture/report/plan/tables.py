"""Suture plans and the paper's Table I as tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

SHORT = {"clockwise": "clockwise", "counterclockwise": "counterclockw."}


def plan_table(summary: Mapping[str, Any]) -> Table:
    """Return the sutures of a plan: position, direction, distance of the joints from their limits, reward.

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
    """Return Table I beside the paper's; 100 is the best plan of each.

    Args:
        points: entries by location and allowed directions.
        paper: the same as printed in the paper.
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
    for name, gain in gains.items():
        theirs = paper[name]
        points = (f"{value['points']:.1f}" for value in (gain, theirs))
        ratios = (
            "-" if value["ratio_percent"] is None else f"{value['ratio_percent']:.1f} %" for value in (gain, theirs)
        )
        table.add_row(name, *points, *ratios)
    return table


def sweep_table(sweep: Mapping[str, Any]) -> Table:
    """Return where the best plan starts at each lambda (Fig. 7).

    Args:
        sweep: ``LambdaSweep.summary()``.
    """
    table = Table(title="Fig. 7: theta of the first suture, deg, of the best plan at each lambda")
    for weight in ("lambda", *(f"{weight:g}" for weight in sweep["weights"])):
        table.add_column(weight, justify="right", no_wrap=True)
    table.add_row("theta", *(f"{angle:.4g}" for angle in sweep["best_theta_deg"]))
    return table


def choices_table(random: Mapping[str, Any]) -> Table:
    """Return how well each margin formula chooses directions in random setups.

    Args:
        random: ``SetupStatistics.summary()``.
    """
    table = Table(title=f"Directions in {random['setups']} random setups")
    table.add_column("margin", no_wrap=True)
    for column in ("two changes", "two changes without a wrong choice", "wrong", "nearest, points"):
        table.add_column(column, justify="right")
    for name, measure in random["measures"].items():
        table.add_row(
            name,
            _percent(measure["two_switches"]),
            _percent(measure["two_switches_where_no_choice_is_wrong"]),
            _percent(measure["wrong_choice_share"]),
            f"{measure['nearest_setup_off_paper_points']:.1f}",
        )
    return table


def spread_table(random: Mapping[str, Any]) -> Table:
    """Return the 10th, 50th and 90th percentile of Table I over random setups, by margin formula.

    Args:
        random: ``SetupStatistics.summary()``.
    """
    entries = next(iter(random["measures"].values()))["table_1"]
    table = Table(title=f"Table I of {random['setups']} random setups: 10th, 50th, 90th percentile")
    table.add_column("margin", no_wrap=True)
    for key in entries:
        table.add_column(
            " ".join(part.split()[0] for part in key.split(", "))
            .replace("clockwise", "clockw.")
            .replace("counterclockw.", "counter-clockw."),
            justify="right",
        )
    for name, measure in random["measures"].items():
        rows = (measure["table_1"][key] for key in entries)
        table.add_row(name, *(f"{row['p10']:.0f} {row['p50']:.0f} {row['p90']:.0f}" for row in rows))
    table.add_section()
    table.add_row("the paper", *(f"{entry['paper']:.1f}" for entry in entries.values()))
    return table


def fits_table(fits: Sequence[Mapping[str, Any]]) -> Table:
    """Return setups that reproduce Table I, one for each margin formula.

    Args:
        fits: ``TableFit.summary()`` of each setup.
    """
    table = Table(title="Table I from four setups, one for each margin formula")
    for column in ("margin", "random cw ccw best", "optimal cw ccw", "off", "changes deg"):
        table.add_column(column, justify="left" if column == "margin" else "right", no_wrap=True)
    for fit in fits:
        random, optimal = fit["points"]
        table.add_row(
            fit["margin"],
            " ".join(f"{value:.1f}" for value in random),
            " ".join(f"{value:.1f}" for value in optimal[:2]),
            f"{fit['largest_difference_points']:.1f}",
            ", ".join(f"{angle:.0f}" for angle in fit["switches_deg"]),
        )
    return table


def setup_table(free: Sequence[Mapping[str, Any]]) -> Table:
    """Return the parameters of a setup that were searched over.

    Args:
        free: ``name`` with its unit, ``from``, ``to``, ``low`` and ``high`` of each parameter.
    """
    table = Table(title="The best setup found")
    table.add_column("parameter", no_wrap=True)
    for column in ("preset", "found", "from", "to"):
        table.add_column(column, justify="right", no_wrap=True)
    for parameter in free:
        shown = (f"{parameter[key]:.1f}" for key in ("from", "to", "low", "high"))
        table.add_row(parameter["name"].replace("_", " "), *shown)
    return table


def _percent(share: float | None) -> str:
    """Return a share as text, a dash where there is none."""
    return "-" if share is None else f"{100 * share:.1f} %"
