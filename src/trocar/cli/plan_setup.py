"""``trocar plan setup``: where to put circle, port and grasp so that the best plan of sutures is best."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from trocar.arms import ARMS
from trocar.cli import suture_options as options
from trocar.cli.out_folder import check_out_folder
from trocar.cli.suture_search import Search
from trocar.errors import TrocarError
from trocar.sutures import PRESETS, DexterityMap, Preset, SuturePlan, dexterity
from trocar.sutures.parameters import RANGES, check_bounds, parameters_of, shown
from trocar.sutures.rewards import Scales

GROUPS = ("circle", "port", "grasp")
POSITIONS = 360
FILES = ("setup.json", "plan.png")


def setup(
    *,
    preset: options.PresetName = "default",
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help=f"What may change; may be given again: {', '.join(GROUPS)}, or a number such as base_tilt_deg; "
            "default: all three groups, with --proven the circle.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a number, such as circle_radius_mm=25:35."),
    ] = None,
    proven: Annotated[
        bool, typer.Option("--proven", help="Branch and bound with a proven bound; for the circle's numbers alone.")
    ] = False,
    gap: Annotated[
        float | None,
        typer.Option(help="With --proven: reward that may be left between plan and bound; default: .02."),
    ] = None,
    evaluations: Annotated[int, typer.Option(help="About how many setups to look at; with --proven, at most.")] = 2000,
    seed: Annotated[int | None, typer.Option(help="Of the search without --proven; default: 0.")] = None,
    any_grasp: Annotated[bool, typer.Option("--any-grasp", help="Also grasps that flat jaws could not hold.")] = False,
    arm: options.ArmName = None,
    count: Annotated[int, typer.Option(help="How many sutures.")] = 4,
    least_gap: Annotated[float | None, typer.Option(metavar="DEG", help="Least gap; default: even.")] = None,
    most_gap: Annotated[float | None, typer.Option(metavar="DEG", help="Largest gap; default: even.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Save setup.json and the plan's picture.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Search circle, port and grasp for the setup whose best plan of sutures is best.

    For each setup the plan is exact on its grid. Over setups the search is heuristic or, with --proven, certified.
    Rewards are scaled as those of the preset. Exit code 1: no feasible plan was found.
    """
    from trocar.report.sutures.summary import finite  # noqa: PLC0415
    from trocar.report.sutures.tissue import tissue_summary  # noqa: PLC0415

    chosen = options.chosen(PRESETS, preset, "preset")
    check_out_folder(out, FILES)
    names, bounds = _names(free or (["circle"] if proven else GROUPS)), dict(_bound(text) for text in bound or ())
    if proven and (seed is not None or arm is not None):
        raise TrocarError(
            "--proven draws nothing at random and keeps the preset's arm; leave --seed and --arm out, or --proven"
        )
    if gap is not None and not proven:
        raise TrocarError("--gap is what --proven may leave open; add --proven or leave it out")
    search = Search(count, options.spacing_of(count, POSITIONS, least_gap, most_gap, (), (), 0.0), seed=seed or 0)
    start = dexterity(chosen.setup, chosen.reward, POSITIONS)
    usual = search.on_grid(start)
    if arm is not None:
        chosen = replace(chosen, setup=replace(chosen.setup, arm=options.chosen(ARMS, arm, "arm")))
    if proven:
        best, plan, answer = _certified(chosen, names, bounds, search, 0.02 if gap is None else gap, evaluations)
    else:
        best, plan, answer = _heuristic(chosen, names, bounds, search, evaluations, not any_grasp, start.scales)
    asked = {"--arm": arm, "--least-gap": least_gap, "--most-gap": most_gap}
    written = [f"--preset {preset}", f"--count {count}", *(f"{name} {x}" for name, x in options.given(asked).items())]
    written += options.written(best.setup, chosen.setup)
    summary: dict[str, Any] = finite(
        {
            "preset": preset,
            "start_reward": usual.reward,
            "start_feasible": usual.feasible,
            **answer,
            "free": [_in_mm_and_deg(chosen, name, values) for name, values in answer["free"].items()],
            "positions_deg": np.degrees(plan.positions_rad).round(9).tolist(),
            "directions": plan.directions.tolist(),
            **tissue_summary(best.setup, plan),
            "manipulability_source": best.source,
            "command": f"trocar plan suture {' '.join(written)}",
        }
    )
    if out is not None:
        summary["files"] = _save(out, best, plan, summary)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary)
    if not plan.feasible:
        typer.echo("trocar: no feasible plan was found; widen the bounds or free more numbers", err=True)
        raise typer.Exit(1)


def _heuristic(
    chosen: Preset,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    search: Search,
    evaluations: int,
    holdable: bool,
    scales: Scales,
) -> tuple[DexterityMap, SuturePlan, dict[str, Any]]:
    """Return map, plan and summary of the best setup that evolution finds, with a progress bar."""
    from trocar.sutures.outer import outer_search  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("setups", total=evaluations)
        found = outer_search(
            chosen.setup,
            chosen.reward,
            names,
            rng=np.random.default_rng(search.seed),
            bounds=bounds,
            planner=search.on_grid,
            positions=POSITIONS,
            evaluations=evaluations,
            holdable=holdable,
            scales=scales,
            progress=lambda done, total: progress.update(bar, completed=done, total=total),
        )
    return found.best, found.plan, found.summary()


def _certified(
    chosen: Preset,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    search: Search,
    gap: float,
    evaluations: int,
) -> tuple[DexterityMap, SuturePlan, dict[str, Any]]:
    """Return map, plan and summary of the best circle, with the gap that is left while it is searched."""
    from trocar.sutures.outer_bound import certified_search  # noqa: PLC0415

    console = Console(stderr=True)
    with console.status("branch and bound") as status:
        found = certified_search(
            chosen.setup,
            chosen.reward,
            names,
            bounds=bounds,
            planner=search.on_grid,
            positions=POSITIONS,
            gap=gap,
            most_boxes=evaluations,
            progress=lambda boxes, left: status.update(f"branch and bound: {boxes} boxes, gap {left:.4f}"),
        )
    return found.best, found.plan, found.summary()


def _names(free: Sequence[str]) -> tuple[str, ...]:
    """Return the names of numbers for groups and for names with the units of the command line."""
    from trocar.sutures.outer import GRASP, PLACEMENT, PORT  # noqa: PLC0415

    groups: dict[str, tuple[str, ...]] = dict(zip(GROUPS, (PLACEMENT, PORT, GRASP), strict=True))
    names = [name for entry in free for name in (groups[entry] if entry in groups else (_inside(entry),))]
    return tuple(dict.fromkeys(names))


def _inside(name: str) -> str:
    """Return the name inside of a number in mm or deg."""
    inside = {shown(known)[1]: known for known in RANGES}
    if name not in inside:
        raise TrocarError(f"a setup has no number {name!r}; choose of {', '.join((*GROUPS, *inside))}")
    return inside[name]


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    """Return name and bounds inside from ``NAME=LOW:HIGH``."""
    name, equals, ends = text.partition("=")
    try:
        if not equals:
            raise ValueError
        inside = _inside(name)
        low, high = (float(end) / shown(inside)[0] for end in ends.split(":"))
    except ValueError:
        raise TrocarError(f"the bound is {text!r}; give NAME=LOW:HIGH, such as circle_radius_mm=25:35") from None
    check_bounds(inside, low, high)
    return inside, (low, high)


def _in_mm_and_deg(chosen: Preset, name: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Return a free number with its bounds, where it was and where it is."""
    scale, said = shown(name)
    ends = {"from": parameters_of(chosen.setup)[name], **values}
    return {"name": said, **{key: scale * ends[key] for key in ("from", "to", "low", "high")}}


def _save(out: Path, best: DexterityMap, plan: SuturePlan, summary: dict[str, Any]) -> list[str]:
    """Write the setup and the picture of its plan; return where they are."""
    from trocar.report.sutures.circle import draw_plan  # noqa: PLC0415

    out.mkdir(parents=True, exist_ok=True)
    names = [str(out / "setup.json"), str(draw_plan(best, plan, out / "plan.png"))]
    (out / "setup.json").write_text(json.dumps({**summary, "files": names}, indent=2) + "\n", encoding="utf-8")
    return names


def _print(summary: dict[str, Any]) -> None:
    """Print what was found and how to plan with it."""
    from trocar.report.sutures.tables import setup_table  # noqa: PLC0415
    from trocar.report.sutures.tissue import tissue_warnings  # noqa: PLC0415

    console = Console()
    console.print(setup_table(summary["free"]))
    was = f"{summary['start_reward']:.4f}" if summary["start_feasible"] else "none that is feasible"
    console.print(f"worst suture {summary['reward']:.4f}, with the preset {was}, scaled alike")
    console.print(summary["certified"])
    looked = "evaluations" if "evaluations" in summary else "boxes"
    console.print(f"{summary[looked]} {'setups' if looked == 'evaluations' else looked} in {summary['seconds']:.1f} s")
    console.print(f"manipulability: {summary['manipulability_source']}")
    for warning in tissue_warnings(summary):
        console.print(warning)
    console.print(f"plan there (scaled anew): {summary['command']}", soft_wrap=True)
    if "files" in summary:
        console.print("files: " + ", ".join(summary["files"]), soft_wrap=True)
