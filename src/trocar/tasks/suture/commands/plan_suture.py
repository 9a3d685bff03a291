"""``trocar plan suture``: the best positions and directions of sutures round a circle."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trocar.cli.extras import need
from trocar.cli.out_folder import check_out_folder
from trocar.cli.terminal import results
from trocar.errors import TrocarError
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import suture_options as options
from trocar.tasks.suture.commands.suture_options import REWARD, SPACING, metre, option, rad
from trocar.tasks.suture.commands.suture_search import Search
from trocar.tasks.suture.planning import PRESETS, dexterity

if TYPE_CHECKING:
    from rich.console import Console

    from trocar.tasks.suture.planning.plan import SuturePlan
    from trocar.tasks.suture.planning.rewards import DexterityMap

PAPER_PRESET = "paper-demo"
KIND = "plan of sutures"
FILES = {"plan.json": KIND, "plan.png": PICTURE, "reasons.png": PICTURE}
"""The files that are written, with their kinds."""


def suture(
    *,
    preset: options.PresetName = "default",
    count: Annotated[int, typer.Option(help="Number of sutures.")] = 4,
    positions: Annotated[int, typer.Option(help="Number of grid positions round the circle.")] = 360,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Save plan.json and pictures here.")] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Show arm and needle along the sutures in the browser; Ctrl-C ends.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    min_gap_deg: Annotated[float | None, option(SPACING, "Smallest gap of neighbours; default: even.", "DEG")] = None,
    max_gap_deg: Annotated[float | None, option(SPACING, "Largest gap of neighbours; default: even.", "DEG")] = None,
    forbid_deg: Annotated[
        list[str] | None, option(SPACING, "Arc without sutures, counterclockwise; repeatable.", "FROM:TO")
    ] = None,
    fix_deg: Annotated[
        list[float] | None, option(SPACING, "Position that must hold a suture; repeatable.", "DEG")
    ] = None,
    tension: Annotated[
        float, option(SPACING, "Weight of uneven gaps: |gap - even| / even, at its largest, lowers the reward.")
    ] = 0.0,
    exhaustive: Annotated[
        bool, option(SPACING, "Enumerate all plans, as the paper does; the result is the same.", name="--exhaustive")
    ] = False,
    continuous: Annotated[
        bool, option(SPACING, "Plan at any angles, not only on the grid, with a proven bound.", name="--continuous")
    ] = False,
    demonstrations: options.DemonstrationsPath = None,
    robust: Annotated[
        bool,
        option(REWARD, "Maximise the worst case over balanced errors of wrist joints and circle.", name="--robust"),
    ] = False,
    scenarios: Annotated[
        int | None, option(REWARD, "Number of random errors that assess the robust plan; default: 100.")
    ] = None,
    seed: Annotated[int | None, option(REWARD, "Seed of these random errors; default: 0.")] = None,
    margin: options.Margin = None,
    weight: options.Weight = None,
    scaling: options.Scaling = None,
    joints: options.Joints = None,
    at: options.At = None,
    feasible_first: options.FeasibleFirst = None,
    arm: options.ArmName = None,
    circle_radius_mm: options.CircleRadius = None,
    center_mm: options.Center = None,
    normal: options.Normal = None,
    base_azimuth_deg: options.BaseAzimuth = None,
    base_sideways_mm: options.BaseSideways = None,
    base_up_mm: options.BaseUp = None,
    base_tilt_deg: options.BaseTilt = None,
    base_spin_deg: options.BaseSpin = None,
    needle_radius_mm: options.NeedleRadius = None,
    needle_arc_deg: options.NeedleArc = None,
    behind_tip_deg: options.BehindTip = None,
    approach_deg: options.Approach = None,
    lean_deg: options.Lean = None,
    skew_deg: options.Skew = None,
    entry_angle_deg: options.EntryAngle = None,
    straight_mm: options.Straight = None,
    rotation_deg: options.Rotation = None,
    regrasp_deg: options.Regrasp = None,
    pushes: options.Pushes = None,
    theta_is: options.ThetaIs = None,
) -> None:
    """Plan where to place sutures round a circle, and in which direction to drive each.

    The plan maximises the worst suture's reward: lambda times the joint margin plus (1 - lambda) times the
    manipulability. Exit code 1: no plan is feasible.
    """
    chosen = options.chosen(PRESETS, preset, "preset")
    reward = options.changed_reward(
        chosen, margin=margin, weight=weight, scaling=scaling, joints=joints, at=at, feasible_first=feasible_first
    )
    setup = options.changed_setup(
        chosen,
        arm=arm,
        center_mm=center_mm,
        normal=normal,
        circle={"radius_m": metre(circle_radius_mm)},
        base={
            "azimuth_rad": rad(base_azimuth_deg),
            "sideways_m": metre(base_sideways_mm),
            "up_m": metre(base_up_mm),
            "tilt_rad": rad(base_tilt_deg),
            "spin_rad": rad(base_spin_deg),
        },
        needle={"radius_m": metre(needle_radius_mm), "arc_rad": rad(needle_arc_deg)},
        grasp={
            "behind_tip_rad": rad(behind_tip_deg),
            "approach_rad": rad(approach_deg),
            "lean_rad": rad(lean_deg),
            "skew_rad": rad(skew_deg),
        },
        insertion={
            "entry_angle_rad": rad(entry_angle_deg),
            "straight_m": metre(straight_mm),
            "rotation_rad": rad(rotation_deg),
            "regrasp_rad": rad(regrasp_deg),
            "pushes": pushes,
            "theta_is": theta_is,
        },
    )
    check_out_folder(out, FILES)
    spacing = options.spacing_of(count, positions, min_gap_deg, max_gap_deg, forbid_deg or (), fix_deg or (), tension)
    if view:
        need("view", "viser")
    if not robust and (scenarios, seed) != (None, None):
        raise TrocarError("--scenarios and --seed assess a robust plan; add --robust or leave them out")
    errors = {"scenarios": scenarios, "seed": seed}
    search = Search(count, spacing, exhaustive, continuous, robust, **options.given(errors))
    recorded = options.recorded(demonstrations)
    started = time.perf_counter()
    found = dexterity(
        setup,
        reward,
        positions,
        recorded.manipulability_at if recorded else None,
        recorded.source if recorded else "",
    )
    plan, robustness = search.plan(found, recorded)
    compute_ms = 1e3 * (time.perf_counter() - started)
    summary = _summary(found, plan, preset, compute_ms)
    if robustness is not None:
        summary |= {"robust": robustness.summary(), "sensitivity": search.sensitivity(found, robustness)}
        if not plan.feasible and not summary["problem"]:
            summary["problem"] = (
                f"no plan stays within the limits under all {robustness.scenarios} errors; move the base, turn the "
                "grasp or leave --robust out"
            )
    if arm is not None and not plan.feasible and summary["problem"]:
        summary["problem"] += f"; `trocar plan setup --arm {arm} --free port` searches for a base from which it reaches"
    if out is not None:
        summary["files"] = _save(out, found, plan, summary)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary)
    if not plan.feasible:
        typer.echo(f"trocar: {summary['problem']}", err=True)
        raise typer.Exit(1)
    if view:
        _view(found, plan)


def _summary(found: DexterityMap, plan: SuturePlan, preset: str, compute_ms: float) -> dict[str, Any]:
    """Return all that is printed and saved."""
    from trocar.tasks.suture.planning.study import SUTURES, table_1
    from trocar.tasks.suture.report.plan.summary import plan_summary

    summary = {"preset": preset, **plan_summary(found, plan), "compute_ms": compute_ms}
    if preset == PAPER_PRESET and len(found.thetas_rad) % SUTURES == 0:
        table = table_1(found).summary()
        summary |= {"table": table["points"], "paper_table": table["paper_points"]}
    return summary


def _save(out: Path, found: DexterityMap, plan: SuturePlan, summary: dict[str, Any]) -> list[str]:
    """Write the plan and its pictures; return their paths."""
    from trocar.tasks.suture.report.plan.circle import draw_plan
    from trocar.tasks.suture.report.plan.panels import draw_reasons

    files = [draw_plan(found, plan, out / "plan.png"), draw_reasons(found, plan, out / "reasons.png")]
    names = [str(out / "plan.json"), *map(str, files)]
    write_json(out / "plan.json", {**summary, "files": names}, KIND)
    return names


def _view(found: DexterityMap, plan: SuturePlan) -> None:
    """Serve the plan to the browser until Ctrl-C."""
    from trocar.tasks.suture.view.suture import show_plan

    shown = show_plan(found.setup, plan, found, block=False)
    typer.echo(f"open http://127.0.0.1:{shown.port} in a browser; Ctrl-C ends", err=True)
    with suppress(KeyboardInterrupt):
        shown.play()
    shown.close()


def _print(summary: dict[str, Any]) -> None:
    """Print the plan, the reasons for it, and the files."""
    from trocar.tasks.suture.report.plan.tables import plan_table, points_table
    from trocar.tasks.suture.report.plan.tissue import tissue_warnings

    console = results()
    console.print(plan_table(summary))
    uneven = f" minus {summary['tension_cost']:.4f} for uneven gaps" if summary["tension_cost"] else ""
    among = "" if summary["feasible"] or not summary["feasible_first"] else " of worst infeasible sutures"
    console.print(
        f"worst suture {summary['reward']:.4f}{uneven}; bound{among} {summary['bound']:.4f}: {summary['certified']}; "
        f"{summary['compute_ms']:.1f} ms"
    )
    switches = ", ".join(f"{angle:.4g}" for angle in summary["switches_deg"])
    console.print(
        f"the better direction changes at {switches} deg" if switches else "one direction is better everywhere"
    )
    for arc in summary["unreachable_deg"] if summary["feasible"] else ():
        console.print(f"no suture at {arc['from']:.4g} to {arc['to']:.4g} deg: {arc['reason']}")
    console.print(f"manipulability: {summary['manipulability_source']}")
    if "robust" in summary:
        _print_robust(console, summary["robust"], summary["sensitivity"])
    for warning in tissue_warnings(summary):
        console.print(warning)
    if not summary["jaws_can_hold_needle"]:
        console.print(
            f"the wire leaves the plane of the jaws by {summary['wire_out_of_jaws_deg']:.0f} deg: "
            "flat jaws could not hold the needle in this grasp"
        )
    if "table" in summary:
        console.print(points_table(summary["table"], summary["paper_table"]))
        console.print("Table I identifies neither the formula nor the setup: `trocar study suture` shows why")
    if "files" in summary:
        console.print("files: " + ", ".join(summary["files"]), soft_wrap=True)


def _print_robust(console: Console, robust: dict[str, Any], sensitivity: dict[str, Any]) -> None:
    """Print what the robust plan gains in the worst case, and what it costs without errors."""
    leaves = "" if robust["nominal_feasible_in_every_scenario"] else ", where it leaves the limits"
    planned, nominal, worst = (
        f"{robust[name]:.4f}" for name in ("planned_reward", "nominal_planned_reward", "nominal_worst_reward")
    )
    console.print(
        f"rewards are those under the worst of {robust['scenarios']} errors (balanced, one standard deviation); "
        f"without errors this plan has {planned}. The best plan without errors has {nominal}, and {worst} under the "
        f"worst of these errors{leaves}"
    )
    both = [sensitivity[name] for name in ("robust", "nominal")]
    low = ", that of the plan made without error ".join(
        f"{one['reward_worst_p5_p50'][1]:.4f}, infeasible in {100 * one['infeasible_share']:.0f} %" for one in both
    )
    p50, p95 = both[1]["best_plan_shift_p50_p95_deg"]
    console.print(
        f"under {both[0]['scenarios']} random errors the 5th percentile of this plan is {low}; the best plan for each "
        f"error lies {p50:.3g} deg (median) and {p95:.3g} deg (95th percentile) from the latter"
    )
