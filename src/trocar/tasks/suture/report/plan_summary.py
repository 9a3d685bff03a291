"""A suture plan as plain values, which commands print and save, and as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from trocar.tasks.suture.planning.joints import suture_joints
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.plan_file import setup_values
from trocar.tasks.suture.planning.primitive import sutures_at
from trocar.tasks.suture.planning.problems import (
    circle_out_of_reach,
    crossing_sutures,
    plan_out_of_reach,
    unreachable_arcs,
)
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, SutureSetup

PAIRS_NAMED = 3


def plan_summary(map: DexterityMap, plan: SuturePlan) -> dict[str, Any]:
    """Return a plan and the reasons for it as plain values, angles in degrees.

    Args:
        map: dexterity of all sutures.
        plan: a plan for this map's setup.
    """
    setup, reward = map.setup, map.reward
    sutures = sutures_at(setup, plan.positions_rad, plan.directions)
    problem = "" if plan.feasible else circle_out_of_reach(map.joints) or plan_out_of_reach(sutures)
    found = {
        "positions_deg": _degrees(plan.positions_rad),
        "directions": [suture.direction for suture in sutures],
        "direction_names": [DIRECTION_NAMES[suture.direction] for suture in sutures],
        "rewards": plan.rewards.tolist(),
        "gaps_deg": _degrees(plan.gaps_rad),
        "joint_room": joint_room(setup, plan),
        "reward": plan.reward,
        "tension_cost": plan.tension_cost,
        "value": plan.value,
        "bound": plan.bound,
        "certified": plan.certified,
        "feasible": plan.feasible,
        "problem": problem,
        "arm": setup.arm.name,
        "setup": setup_values(setup),
        "margin": reward.margin,
        "weight": reward.weight,
        "scaling": reward.scaling,
        "joints": reward.joints,
        "margin_at": reward.at,
        "feasible_first": reward.feasible_first,
        "grid_positions": len(map.thetas_rad),
        "manipulability_source": map.source,
        "switches_deg": _degrees(map.switches_rad),
        "unreachable_deg": [
            {"from": math.degrees(arc.from_rad), "to": math.degrees(arc.to_rad), "reason": arc.reason}
            for arc in unreachable_arcs(map.joints)
        ],
        **tissue_summary(setup, plan),
        "jaws_can_hold_needle": setup.grasp.holdable,
        "wire_out_of_jaws_deg": math.degrees(setup.grasp.out_of_jaws_rad),
    }
    return finite(found)


def joint_room(setup: SutureSetup, plan: SuturePlan) -> list[dict[str, float]]:
    """Return how far each joint stays from the nearer end of its range along each suture, by its name and unit."""
    arm, joints = setup.arm, suture_joints(setup, plan.positions_rad)
    rows = [suture.row for suture in sutures_at(setup, plan.positions_rad, plan.directions)]
    q = joints.q[rows, np.arange(len(rows))]
    left = np.minimum(q - arm.lower, arm.upper - q).min(1)
    left = left * np.array([joint.shown_scale[0] for joint in arm.joints])
    names = [f"{joint.name}_{joint.shown_scale[1]}" for joint in arm.joints]
    return [dict(zip(names, row, strict=True)) for row in left.tolist()]


def tissue_summary(setup: SutureSetup, plan: SuturePlan) -> dict[str, Any]:
    """Return which sutures of a plan cross and whether the needle comes out, angles in degrees."""
    pairs = crossing_sutures(sutures_at(setup, plan.positions_rad, plan.directions))
    exit_rad = setup.exit_turn_rad
    return {
        "crossing_deg": [[round(math.degrees(plan.positions_rad[i]), 9) for i in pair] for pair in pairs],
        "needle_comes_out": setup.comes_out,
        "needle_turn_deg": math.degrees(setup.insertion.turn_rad),
        "needle_exit_turn_deg": None if math.isnan(exit_rad) else math.degrees(exit_rad),
    }


def tissue_warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return one sentence per problem in the tissue, from the values of ``tissue_summary``."""
    found = []
    if pairs := summary["crossing_deg"]:
        named = ", ".join(f"{one:.4g} and {other:.4g}" for one, other in pairs[:PAIRS_NAMED])
        more = f" and {len(pairs) - PAIRS_NAMED} more pairs" if len(pairs) > PAIRS_NAMED else ""
        found.append(
            f"warning: sutures cross in the tissue, seen from above: {named} deg{more}; ask for wider gaps or fewer "
            "sutures, a larger circle or a smaller needle"
        )
    if not summary["needle_comes_out"]:
        out = summary["needle_exit_turn_deg"]
        enough = "but no rotation brings its tip out" if out is None else f"but its tip comes out at {out:.1f} deg"
        found.append(
            f"warning: the needle never comes out of the tissue: it is turned by {summary['needle_turn_deg']:.1f} deg, "
            f"{enough}; {'shorten the straight path' if out is None else 'turn it farther or push it more often'}"
        )
    return found


def finite(value: Any) -> Any:
    """Return plain values with None in place of numbers that are not finite, which JSON lacks."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _degrees(angles_rad: NDArray[np.float64]) -> list[float]:
    """Return angles in degrees, rounded to remove the error of the conversion."""
    return np.degrees(angles_rad).round(9).tolist()


# Tables for the terminal.


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
    names = list(summary["joint_room"][0])
    shown = names if summary["joints"] == "all" else names[3:]
    parts = [name.rpartition("_") for name in shown]
    left = [f"{joint.replace('_', ' ')} left, {unit}" for joint, _, unit in parts]
    table = Table(title=f"{len(summary['positions_deg'])} sutures by {summary['arm']}")
    for column in ("theta deg", "direction", *left, "reward"):
        justify = "left" if column == "direction" else "right"
        table.add_column(column, justify=justify, no_wrap=column not in left)
    columns = (summary[key] for key in ("positions_deg", "direction_names", "joint_room", "rewards"))
    for theta, direction, room, value in zip(*columns, strict=True):
        table.add_row(
            f"{theta:.4g}",
            direction.replace("counterclockwise", "counterclockw."),
            *("-" if room[name] is None else f"{room[name]:.1f}" for name in shown),
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
