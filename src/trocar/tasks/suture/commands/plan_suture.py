"""``trocar plan suture``: the best positions and directions of sutures round a circle."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from trocar.cli.group import Result
from trocar.cli.options import JsonFlag, need
from trocar.cli.out_folder import check_out_folder
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.commands.options import SPACING, option
from trocar.tasks.suture.planning import PRESETS, DexterityMap, Spacing, SuturePlan, dexterity, refined

PAPER_PRESET = "paper-demo"
KIND = "plan of sutures"
FILES = {"plan.json": KIND, "plan.png": PICTURE, "reasons.png": PICTURE}
"""The files that are written, with their kinds."""


@options.with_options
def suture(
    *,
    preset: options.PresetName = "default",
    count: Annotated[int, typer.Option(help="Number of sutures.")] = 4,
    positions: Annotated[int, typer.Option(help="Number of grid positions round the circle.")] = 360,
    out: options.Out = None,
    view: Annotated[
        bool, typer.Option("--view", help="Show arm and needle along the sutures in the browser; Ctrl-C ends.")
    ] = False,
    min_gap_deg: options.MinGap = None,
    max_gap_deg: options.MaxGap = None,
    forbid_deg: Annotated[
        list[str] | None, option(SPACING, "Arc without sutures, counterclockwise; repeatable.", "FROM:TO")
    ] = None,
    fix_deg: Annotated[
        list[float] | None, option(SPACING, "Position that must hold a suture; repeatable.", "DEG")
    ] = None,
    tension: Annotated[
        float, option(SPACING, "Weight of uneven gaps: |gap - even| / even, at its largest, lowers the reward.")
    ] = 0.0,
    continuous: Annotated[
        bool, option(SPACING, "Refine the plan to any angles, by a local search.", name="--continuous")
    ] = False,
    demonstrations: options.DemonstrationsPath = None,
    arm: options.ArmName = None,
    as_json: JsonFlag = False,
    given: dict[str, Any],
) -> None:
    """Plan where to place sutures round a circle, and in which direction to drive each.

    The plan maximises the worst suture's reward: lambda times the joint margin plus (1 - lambda) times the
    manipulability. Exit code 1: no plan is feasible.
    """
    chosen = options.pick(PRESETS, preset, "preset")
    reward, setup = options.reward_of(chosen, given), options.setup_of(chosen, arm, given)
    check_out_folder(out, FILES)
    spacing = options.spacing_of(count, positions, min_gap_deg, max_gap_deg, forbid_deg or (), fix_deg or (), tension)
    if view:
        need("view")
    recorded = options.recorded(demonstrations)
    started = time.perf_counter()
    map = dexterity(setup, reward, positions, recorded)
    plan = options.planner_of(count, spacing)(map)
    if continuous:
        plan = refined(map, plan, spacing or Spacing.even(count))
    compute_ms = 1e3 * (time.perf_counter() - started)
    summary = _summary(map, plan, preset, compute_ms)
    if arm is not None and summary["problem"]:
        summary["problem"] += f"; `trocar plan setup --arm {arm} --free port` searches for a base from which it reaches"
    if out is not None:
        summary["files"] = _save(out, map, plan, summary)
    if not plan.feasible:
        typer.echo(f"trocar: {summary['problem']}", err=True)
    Result(summary, _lines(summary), succeeded=plan.feasible).show(as_json)
    if view:
        _view(map, plan)


def _summary(map: DexterityMap, plan: SuturePlan, preset: str, compute_ms: float) -> dict[str, Any]:
    """Return all that is printed and saved."""
    from trocar.tasks.suture.planning.study import SUTURES, table_1
    from trocar.tasks.suture.report.plan_summary import plan_summary

    summary = {"preset": preset, **plan_summary(map, plan), "compute_ms": compute_ms}
    if preset == PAPER_PRESET and len(map.thetas_rad) % SUTURES == 0:
        table = table_1(map).summary()
        summary |= {"table": table["points"], "paper_table": table["paper_points"]}
    return summary


def _save(out: Path, map: DexterityMap, plan: SuturePlan, summary: dict[str, Any]) -> list[str]:
    """Write the plan and its pictures; return their paths."""
    from trocar.tasks.suture.report.circle import draw_plan
    from trocar.tasks.suture.report.panels import draw_reasons

    files = [out / "plan.json", draw_plan(map, plan, out / "plan.png"), draw_reasons(map, plan, out / "reasons.png")]
    write_json(out / "plan.json", {**summary, "files": [str(file) for file in files]}, KIND)
    return [str(file) for file in files]


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
    from trocar.tasks.suture.report.plan_summary import plan_table, points_table, tissue_warnings

    uneven = f" minus {summary['tension_cost']:.4f} for uneven gaps" if summary["tension_cost"] else ""
    among = "" if summary["feasible"] or not summary["feasible_first"] else " of worst infeasible sutures"
    bound = "" if summary["bound"] is None else f"bound{among} {summary['bound']:.4f}: "
    switches = ", ".join(f"{angle:.4g}" for angle in summary["switches_deg"])
    lines = [
        plan_table(summary),
        f"worst suture {summary['reward']:.4f}{uneven}; {bound}{summary['certified']}; {summary['compute_ms']:.1f} ms",
        f"the better direction changes at {switches} deg" if switches else "one direction is better everywhere",
    ]
    if summary["feasible"]:
        arcs = summary["unreachable_deg"]
        lines += [f"no suture at {arc['from']:.4g} to {arc['to']:.4g} deg: {arc['reason']}" for arc in arcs]
    lines += [f"manipulability: {summary['manipulability_source']}", *tissue_warnings(summary)]
    if not summary["jaws_can_hold_needle"]:
        lines.append(
            f"the wire leaves the plane of the jaws by {summary['wire_out_of_jaws_deg']:.0f} deg: "
            "flat jaws could not hold the needle in this grasp"
        )
    if "table" in summary:
        lines.append(points_table(summary["table"], summary["paper_table"]))
        lines.append("Table I identifies neither the formula nor the setup: the preset was fitted to it")
    return lines + options.files_line(summary)
