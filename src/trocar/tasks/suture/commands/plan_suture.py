"""``trocar plan suture``: the best positions and directions of sutures round a circle."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from trocar.arms import ARMS
from trocar.cli.group import Result
from trocar.cli.options import JsonFlag, need
from trocar.cli.out_folder import check_out_folder
from trocar.counting import counted
from trocar.errors import InvalidValue
from trocar.files.output import PICTURE, write_json
from trocar.geometry import SE3
from trocar.geometry.arrays import finite
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.commands.options import GIVEN, REWARD, SPACING, option
from trocar.tasks.suture.planning import (
    MARGINS,
    PRESETS,
    DexterityMap,
    Preset,
    Spacing,
    SuturePlan,
    SutureSetup,
    dexterity,
    refined,
)
from trocar.tasks.suture.planning.setup import PARAMETERS, shown_parameter, with_parameters

PAPER_PRESET = "paper-demo"
KIND = "plan of sutures"
FILES = {"plan.json": KIND, "plan.png": PICTURE, "reasons.png": PICTURE}
"""The files that are written, with their kinds."""
MAX_CENTER_MM = 500.0

OF_REWARD: dict[str, Any] = {
    "margin": Annotated[str | None, option(REWARD, f"Formula of the joint margin: {', '.join(MARGINS)}.")],
    "weight": Annotated[
        float | None, option(REWARD, "lambda, the weight of the margin; manipulability gets the rest.")
    ],
}
"""Fields of ``Reward``."""
OF_INSERTION: dict[str, Any] = {
    "regrasp_deg": Annotated[
        float | None, option(GIVEN, "How far the jaws move back along the needle.", "DEG", "--regrasp-deg")
    ],
    "pushes": Annotated[int | None, option(GIVEN, "How often the jaws go back along the needle and push it on.")],
    "theta_is": Annotated[str | None, option(GIVEN, "Which point of a suture lies at theta: entry or middle.")],
}
"""Fields of ``Insertion``."""
SAID = {name: shown_parameter(name)[1] for name in PARAMETERS}
"""Parameters of a setup as the command line calls them, in mm or deg."""
OF_SETUP: dict[str, Any] = {
    SAID[name]: Annotated[
        float | None,
        option(GIVEN, of.about, "MM" if name.endswith("_m") else "DEG", "--" + SAID[name].replace("_", "-")),
    ]
    for name, of in PARAMETERS.items()
    if not name.startswith("center")
} | {
    "center_mm": Annotated[
        tuple[float, float, float] | None, option(GIVEN, "Centre of the circle in the world.", "X Y Z", "--center-mm")
    ]
}
"""Parameters of a setup."""


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of a reward and a setup; its function gets those that were given, by name."""
    added = {**OF_REWARD, **OF_SETUP, **OF_INSERTION}
    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "given"]
    keyword = inspect.Parameter.KEYWORD_ONLY
    both = [*own, *(inspect.Parameter(name, keyword, default=None, annotation=kind) for name, kind in added.items())]

    def command(**values: Any) -> None:
        given = {name: value for name in added if (value := values.pop(name)) is not None}
        function(given=given, **values)

    command.__doc__ = function.__doc__
    command.__signature__ = inspect.Signature(both)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in both}
    return command


def setup_of(preset: Preset, arm: str | None, given: Mapping[str, Any]) -> SutureSetup:
    """Return the preset's setup with another arm, and with the options that were given."""
    setup, circle = preset.setup, preset.setup.circle
    insertion = {name: given[name] for name in OF_INSERTION if name in given}
    if "regrasp_deg" in insertion:
        insertion["regrasp_rad"] = options.in_si("regrasp_rad", insertion.pop("regrasp_deg"))
    if "center_mm" in given:
        center_mm = finite("the circle's centre in mm", given["center_mm"], 3)
        if np.abs(center_mm).max() > MAX_CENTER_MM:
            limits = "give three numbers from -500 to 500 mm"
            raise InvalidValue("the circle's centre", f"{tuple(center_mm.tolist())} mm", limits)
        circle = replace(circle, T_world_circle=SE3.from_parts(circle.T_world_circle.rotation, center_mm / 1e3))
    return with_parameters(
        setup,
        {name: options.in_si(name, given[said]) for name, said in SAID.items() if said in given},
        arm=setup.arm if arm is None else options.pick(ARMS, arm, "arm"),
        circle=circle,
        insertion=replace(setup.insertion, **insertion),
    )


@with_options
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
    reward = replace(chosen.reward, **{name: given[name] for name in OF_REWARD if name in given})
    setup = setup_of(chosen, arm, given)
    check_out_folder(out, FILES)
    spacing = options.spacing_of(count, positions, min_gap_deg, max_gap_deg, forbid_deg or (), fix_deg or ())
    if view:
        need("view")
    recorded = options.recorded(demonstrations)
    started = time.perf_counter()
    map = dexterity(setup, reward, positions, recorded)
    plan = options.planner_of(count, spacing)(map)
    if continuous:
        plan = refined(map, plan, spacing or Spacing.even(count))
    summary = _summary(map, plan, preset, 1e3 * (time.perf_counter() - started))
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
    from trocar.tasks.suture.planning.study import PAPER_TABLE_1, SUTURES, by_name, table_1
    from trocar.tasks.suture.planning.summary import plan_summary

    summary = {"preset": preset, **plan_summary(map, plan), "compute_ms": compute_ms}
    if preset == PAPER_PRESET and len(map.thetas_rad) % SUTURES == 0:
        summary |= {"table": by_name(table_1(map)), "paper_table": by_name(PAPER_TABLE_1)}
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
    if not summary["jaws_can_hold_needle"]:
        lines.append(
            f"the wire leaves the plane of the jaws by {summary['wire_out_of_jaws_deg']:.0f} deg: "
            "flat jaws could not hold the needle in this grasp"
        )
    if "table" in summary:
        lines.append(options.points_table(summary["table"], summary["paper_table"]))
        lines.append("Table I identifies neither the formula nor the setup: the preset was fitted to it")
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
            direction.replace("counterclockwise", "counterclockw."),
            *("-" if room[name] is None else f"{room[name]:.1f}" for name in shown),
            f"{value:.4f}",
            style="bold" if value == min(summary["rewards"]) else None,
        )
    return table
