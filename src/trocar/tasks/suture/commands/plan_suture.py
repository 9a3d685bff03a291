"""``trocar plan suture``: the best positions and directions of sutures round a circle."""

from __future__ import annotations

import math
import multiprocessing
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from trocar.cli.group import Result
from trocar.cli.options import JsonFlag, need
from trocar.cli.out_folder import check_out_folder
from trocar.counting import counted
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.files.output import PICTURE, require_place, write_json, write_table
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.commands.options import REWARD, SPACING, option
from trocar.tasks.suture.planning import (
    MARGINS,
    DexterityMap,
    Spacing,
    SuturePlan,
    dexterity,
    refined,
    sutures_at,
)
from trocar.tasks.suture.planning.plan import PLAN
from trocar.tasks.suture.planning.primitive import jaws_above_m
from trocar.tasks.suture.planning.two_arm_waypoints import TWO_ARM_COLUMNS, Pair, two_arm_rows, two_arm_waypoints
from trocar.tasks.suture.planning.two_arms import plan_pulled, plan_two_arms
from trocar.tasks.suture.planning.waypoints import COLUMNS, rows, waypoints, waypoints_values
from trocar.tasks.suture.variants import SINGLE, STATIONS, TWO, pair_of

if TYPE_CHECKING:
    from trocar.lab import Station

PAPER_PRESET = "paper-demo"
KIND = "plan of sutures"
WAYPOINTS = "waypoints of sutures"
FILES = {PLAN: KIND, "plan.png": PICTURE, "reasons.png": PICTURE, "waypoints.json": WAYPOINTS}
"""The files that are written besides the tables, with their kinds."""
TABLE, TWO_ARM_TABLE = "waypoints.csv", "waypoints_two_arms.csv"
WARM_UP = 8
"""Positions of the map that is made as a warm-up before the timed one."""


def suture(
    *,
    preset: options.PresetName = "default",
    count: options.Count = 4,
    positions: Annotated[
        int | None,
        typer.Option(
            help="Number of grid positions round the circle; default: 360, or the next multiple of the count."
        ),
    ] = None,
    out: options.Out = None,
    variant: Annotated[
        str,
        typer.Option(
            help=f"Who sutures: {', '.join(STATIONS)}. Two arms: plan also how the second one, at station "
            f"{STATIONS[TWO]!r}, pulls the needle through and hands it back.",
            metavar="WORD",
        ),
    ] = SINGLE,
    view: Annotated[
        bool, typer.Option("--view", help="Show arm and needle along the sutures in the browser; Ctrl-C ends.")
    ] = False,
    settings: options.Settings = None,
    arm: options.ArmName = None,
    search: options.Search = None,
    gap: options.Gap = None,
    forbid: Annotated[
        list[str] | None, option(SPACING, "Arc without sutures in deg, counterclockwise; repeatable.", "FROM:TO")
    ] = None,
    fix: Annotated[list[float] | None, option(SPACING, "Position that must hold a suture; repeatable.", "DEG")] = None,
    continuous: Annotated[
        bool, option(SPACING, "Refine the plan to any angles, by a local search.", name="--continuous")
    ] = False,
    margin: Annotated[str | None, option(REWARD, f"Formula of the joint margin: {', '.join(MARGINS)}.")] = None,
    weight: Annotated[
        float | None, option(REWARD, "lambda, the weight of the margin; manipulability gets the rest.")
    ] = None,
    joint_weights: Annotated[
        str | None, option(REWARD, "Weights of roll, wrist pitch and yaw in the margin; default: 1,1,1.", "R,P,Y")
    ] = None,
    caution: Annotated[
        float | None,
        option(REWARD, "Subtract so many standard deviations of the demonstrations from their manipulability."),
    ] = None,
    demonstrations: options.DemonstrationsPath = None,
    as_json: JsonFlag = False,
) -> None:
    """Plan where to place sutures round a circle, and in which direction to drive each.

    The plan maximises the worst suture's reward: lambda times the joint margin plus (1 - lambda) times the
    manipulability. Exit code 1: no plan is feasible.
    """
    chosen = options.chosen_preset(preset, settings, arm)
    weights = None if joint_weights is None else _weights(joint_weights)
    asked = {"margin": margin, "weight": weight, "joint_weights": weights, "caution": caution}
    reward = replace(chosen.reward, **{name: value for name, value in asked.items() if value is not None})
    chosen = replace(chosen, reward=reward)
    check_out_folder(out, FILES)
    if variant not in STATIONS:
        raise UnknownName("variant of suture", variant, STATIONS)
    if out is not None:
        require_place(out / TABLE, WAYPOINTS, mark=",".join(COLUMNS))
        require_place(out / TWO_ARM_TABLE, WAYPOINTS, mark=",".join(TWO_ARM_COLUMNS))
    spacing = options.spacing_of(count, search, gap, forbid or (), fix or (), setup=chosen.setup)
    if view:
        need("view")
    recorded = options.recorded(demonstrations)
    # a warm-up: one-time imports and allocations do not count as the planner's time
    options.planner_of(WARM_UP, spacing and Spacing.even(WARM_UP))(dexterity(chosen.setup, reward, WARM_UP, recorded))
    pair = pair_of(_station()) if variant == TWO else None
    started = time.perf_counter()
    planner, positions = options.planner_of(count, spacing), positions or options.grid_of(count)
    if pair is not None:
        map, plan = plan_pulled(chosen, planner, positions, *pair, recorded)
    else:
        map = dexterity(chosen.setup, reward, positions, recorded)
        plan = planner(map)
    if continuous:
        plan = refined(map, plan, spacing or Spacing.even(count))
    summary = _summary(map, plan, preset, chosen.fitted, 1e3 * (time.perf_counter() - started))
    if arm is not None and summary["problem"]:
        parts = "--free port" if jaws_above_m(chosen.setup) >= 0 else "--free port --free grasp"
        summary["problem"] += f"; `trocar plan setup --arm {arm} {parts}` searches for a setup in which it can suture"
    stitches = _two_arms(map, plan, summary) if variant == TWO and plan.feasible else []
    if out is not None:
        summary["files"] = _save(out, map, plan, summary, stitches)
    if not plan.feasible:
        typer.echo(f"trocar: {summary['problem']}", err=True)
    Result(summary, _lines(summary), succeeded=plan.feasible).show(as_json)
    if view:
        _view(map, plan)


def _weights(text: str) -> tuple[float, float, float]:
    """Return the weights of roll, wrist pitch and yaw from ``R,P,Y``."""
    try:
        roll, pitch, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidValue("--joint-weights", repr(text), "give three numbers as R,P,Y, such as 1,2,2") from None
    return roll, pitch, yaw


def _summary(
    map: DexterityMap, plan: SuturePlan, preset: str, fitted: tuple[str, ...], compute_ms: float
) -> dict[str, Any]:
    """Return all that is printed and saved."""
    from trocar.tasks.suture.planning.study import PAPER_TABLE_1, SUTURES, by_name, table_1
    from trocar.tasks.suture.planning.summary import plan_summary

    summary = {"preset": preset, "fitted": list(fitted), **plan_summary(map, plan), "compute_ms": compute_ms}
    if preset == PAPER_PRESET and not map.setup.puller.up_m and len(map.thetas_rad) % SUTURES == 0:
        summary |= {"table": by_name(table_1(map)), "paper_table": by_name(PAPER_TABLE_1)}
    return summary


def _two_arms(map: DexterityMap, plan: SuturePlan, summary: dict[str, Any]) -> list[Pair]:
    """Return the waypoints of two arms, and add their clearances to the summary.

    Raises:
        TrocarError: the first arm is not the station's, or an arm cannot do its part.
    """
    station = _station()
    names = list(station.arms)[:2]
    first = station.arm(names[0])
    if first.model.name != map.setup.arm.name:
        there = f"is for {first.model.name!r}, the first arm of station {station.name!r}, not {map.setup.arm.name!r}"
        raise InvalidInput(f"--variant {TWO}", there, "leave out --arm")
    home_q, puller = pair_of(station)
    sutures = sutures_at(map.setup, plan.positions_rad, plan.directions)
    cameras = [camera.T_world_camera for camera in station.cameras.values()]
    between = plan_two_arms(sutures, home_q, puller, station.T_world_fixture["stand"], cameras)
    stitches = two_arm_waypoints(sutures, between, home_q, puller)
    parts = [*between.pulls, *(handovers[0] for handovers in between.handovers)]
    summary["two_arms"] = {
        "arms": names,
        "seconds": [float(max(one.times_s[-1] for one in pair)) for pair in stitches],
        "room_deg": math.degrees(min(part.room_rad for part in parts)),
        "apart_mm": 1e3 * min(part.apart_m for part in parts),
    }
    return stitches


def _station() -> Station:
    """Return the station of two arms."""
    from trocar.lab import load_station  # takes a tenth of a second, and one arm does not need it

    return load_station(STATIONS[TWO])


def _save(
    out: Path, map: DexterityMap, plan: SuturePlan, summary: dict[str, Any], two_arms: Sequence[Pair]
) -> list[str]:
    """Write the plan, its pictures and, if an arm can follow it, its waypoints; return their paths."""
    files = [out / PLAN, *_draw(map, plan, out)]
    table, values, both = out / TABLE, out / "waypoints.json", out / TWO_ARM_TABLE
    for earlier in (table, values, both):
        earlier.unlink(missing_ok=True)
    if plan.feasible:
        stitches = [waypoints(suture) for suture in sutures_at(map.setup, plan.positions_rad, plan.directions)]
        kept = {name: summary[name] for name in ("arm", "setup", "positions_deg", "directions")}
        write_table(table, COLUMNS, rows(stitches))
        if two_arms:
            names = summary["two_arms"]["arms"]
            kept["two_arms"] = [
                {name: one.values() for name, one in zip(names, pair, strict=True)} for pair in two_arms
            ]
            files.append(write_table(both, TWO_ARM_COLUMNS, two_arm_rows(names, two_arms)))
        write_json(values, {**kept, **waypoints_values(stitches)}, WAYPOINTS)
        files += [table, values]
    write_json(out / PLAN, {**summary, "files": [str(file) for file in files]}, KIND)
    return [str(file) for file in files]


def _draw(map: DexterityMap, plan: SuturePlan, out: Path) -> list[Path]:
    """Draw both pictures; where forking is safe (Linux), the slow second one in a process of its own."""
    from trocar.tasks.suture.report.circle import draw_plan
    from trocar.tasks.suture.report.panels import draw_reasons

    if sys.platform != "linux":
        return [draw_plan(map, plan, out / "plan.png"), draw_reasons(map, plan, out / "reasons.png")]
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as beside:
        reasons = beside.submit(draw_reasons, map, plan, out / "reasons.png")
        return [draw_plan(map, plan, out / "plan.png"), reasons.result()]


def _view(map: DexterityMap, plan: SuturePlan) -> None:
    """Serve the plan to the browser until Ctrl-C."""
    from trocar.tasks.suture.view import PlanView

    shown = PlanView(map, plan)
    typer.echo(f"open http://127.0.0.1:{shown.port} in a browser; Ctrl-C ends", err=True)
    with suppress(KeyboardInterrupt):
        shown.play()
    shown.close()


def _lines(summary: dict[str, Any]) -> list[Any]:
    """Return the plan, the reasons for it, and the files, to be printed."""
    from trocar.tasks.suture.planning.summary import tissue_warnings

    among = "" if summary["feasible"] or not summary["feasible_first"] else " of worst infeasible sutures"
    bound = "" if summary["bound"] is None else f"bound{among} {summary['bound']:.4f}: "
    switches = ", ".join(f"{angle:.4g}" for angle in summary["switches_deg"])
    lines = [
        _plan_table(summary),
        f"worst suture {summary['reward']:.4f}; {bound}{summary['certified']}; {summary['compute_ms']:.1f} ms",
        f"the better direction changes at {switches} deg" if switches else "one direction is better everywhere",
    ]
    if summary["feasible"]:
        arcs = summary["unreachable_deg"]
        lines += [f"no suture at {arc['from']:.4g} to {arc['to']:.4g} deg: {arc['reason']}" for arc in arcs]
    lines += [f"manipulability: {summary['manipulability_source']}", *tissue_warnings(summary)]
    if "two_arms" in summary:
        two = summary["two_arms"]
        lines.append(
            f"two arms: {max(two['seconds']):.0f} s a stitch at most, without looks and computing; their joints keep "
            f"{two['room_deg']:.0f} deg to their limits, the instruments {two['apart_mm']:.1f} mm to each other"
        )
    if not summary["jaws_can_hold_needle"]:
        lines.append(
            f"the wire leaves the plane of the jaws by {summary['wire_out_of_jaws_deg']:.0f} deg: "
            "flat jaws could not hold the needle in this grasp"
        )
    if "table" in summary:
        lines.append(options.points_table(summary["table"], summary["paper_table"]))
        lines.append("Table I identifies neither the formula nor the setup")
    lines += options.fitted_line(summary["fitted"])
    return lines + options.files_line(summary)


def _plan_table(summary: Mapping[str, Any]) -> Table:
    """Return the sutures of a plan: position, direction, distance of the wrist's joints from their limits, reward."""
    shown = list(summary["joint_room"][0])[3:]
    parts = [name.rpartition("_") for name in shown]
    left = [f"{joint.replace('_', ' ')} left, {unit}" for joint, _, unit in parts]
    table = Table(title=f"{counted(len(summary['positions_deg']), 'suture')} by {summary['arm']}")
    for column in ("theta deg", "direction", *left, "reward"):
        justify = "left" if column == "direction" else "right"
        table.add_column(column, justify=justify, no_wrap=column not in left)
    columns = (summary[key] for key in ("positions_deg", "direction_names", "joint_room", "rewards"))
    for theta, direction, room, value in zip(*columns, strict=True):
        table.add_row(
            f"{theta:.4g}",
            direction,
            *("-" if room[name] is None else f"{room[name]:.1f}" for name in shown),
            "-" if None in room.values() else f"{value:.4f}",
            style="bold" if value == min(summary["rewards"]) else None,
        )
    return table
