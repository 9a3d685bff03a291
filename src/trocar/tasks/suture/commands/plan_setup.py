"""``trocar plan setup``: the circle, port and grasp whose best plan of sutures scores highest."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress, waiting
from trocar.cli.terminal import results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import suture_options as options
from trocar.tasks.suture.commands.suture_search import Search
from trocar.tasks.suture.planning import PRESETS, DexterityMap, Preset, SuturePlan, dexterity
from trocar.tasks.suture.planning.parameters import RANGES, check_bounds, parameters_of, shown_parameter
from trocar.tasks.suture.planning.rewards import Scales

GROUPS = ("circle", "port", "grasp")
POSITIONS = 360
KIND = "setup for sutures"
FILES = {"setup.json": KIND, "plan.png": PICTURE}
"""The files that are written, with their kinds."""


def setup(
    *,
    preset: options.PresetName = "default",
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help=f"What may change, repeatable: {', '.join(GROUPS)}, or a parameter such as base_tilt_deg; "
            "default: all three groups, with --proven the circle.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter, such as circle_radius_mm=25:35."),
    ] = None,
    proven: Annotated[
        bool, typer.Option("--proven", help="Branch and bound with a proven bound; for the circle's parameters only.")
    ] = False,
    gap: Annotated[
        float | None,
        typer.Option(help="With --proven: remaining gap between plan and bound, as reward; default: .02."),
    ] = None,
    evaluations: Annotated[
        int, typer.Option(help="Approximate number of setups to evaluate; with --proven, the maximum.")
    ] = 2000,
    seed: Annotated[int | None, typer.Option(help="Seed of the search without --proven; default: 0.")] = None,
    any_grasp: Annotated[
        bool, typer.Option("--any-grasp", help="Also allow grasps in which flat jaws could not hold the needle.")
    ] = False,
    arm: options.ArmName = None,
    count: Annotated[int, typer.Option(help="Number of sutures.")] = 4,
    min_gap_deg: Annotated[float | None, typer.Option(metavar="DEG", help="Smallest gap; default: even.")] = None,
    max_gap_deg: Annotated[float | None, typer.Option(metavar="DEG", help="Largest gap; default: even.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Save setup.json and the plan's picture.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Search for the circle, port and grasp whose best plan of sutures scores highest.

    For each setup the plan is exact on its grid. Over setups the search is heuristic or, with --proven, certified.
    Rewards are scaled as for the preset. Exit code 1: no feasible plan was found.
    """
    from trocar.tasks.suture.report.plan.summary import finite
    from trocar.tasks.suture.report.plan.tissue import tissue_summary

    chosen = options.chosen(PRESETS, preset, "preset")
    check_out_folder(out, FILES)
    names, bounds = _names(free or (["circle"] if proven else GROUPS)), dict(_bound(text) for text in bound or ())
    if proven and (seed is not None or arm is not None):
        raise TrocarError(
            "--proven draws nothing at random and keeps the preset's arm; leave out --seed and --arm, or --proven"
        )
    if gap is not None and not proven:
        raise TrocarError("--gap is the gap that --proven may leave; add --proven or leave it out")
    search = Search(count, options.spacing_of(count, POSITIONS, min_gap_deg, max_gap_deg, (), (), 0.0), seed=seed or 0)
    start = dexterity(chosen.setup, chosen.reward, POSITIONS)
    usual = search.on_grid(start)
    if arm is not None:
        chosen = replace(chosen, setup=replace(chosen.setup, arm=options.chosen(ARMS, arm, "arm")))
    if proven:
        best, plan, answer = _certified(chosen, names, bounds, search, 0.02 if gap is None else gap, evaluations)
    else:
        best, plan, answer = _heuristic(chosen, names, bounds, search, evaluations, not any_grasp, start.scales)
    asked = {"--arm": arm, "--min-gap-deg": min_gap_deg, "--max-gap-deg": max_gap_deg}
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
        typer.echo("trocar: no feasible plan was found; widen the bounds or free more parameters", err=True)
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
    from trocar.tasks.suture.planning.outer import outer_search

    with progress() as tick:
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
            progress=lambda done, total: tick("setups", done, total),
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
    """Return map, plan and summary of the best circle; shows the current gap during the search."""
    from trocar.tasks.suture.planning.outer_bound import certified_search

    with waiting("branch and bound") as say:
        found = certified_search(
            chosen.setup,
            chosen.reward,
            names,
            bounds=bounds,
            planner=search.on_grid,
            positions=POSITIONS,
            gap=gap,
            max_boxes=evaluations,
            progress=lambda boxes, left: say(f"{counted(boxes, 'box', 'boxes')}, gap {left:.4f}"),
        )
    return found.best, found.plan, found.summary()


def _names(free: Sequence[str]) -> tuple[str, ...]:
    """Return parameter names for groups, and for names in the units of the command line."""
    from trocar.tasks.suture.planning.outer import GRASP, PLACEMENT, PORT

    groups: dict[str, tuple[str, ...]] = dict(zip(GROUPS, (PLACEMENT, PORT, GRASP), strict=True))
    names = [name for entry in free for name in (groups[entry] if entry in groups else (_si_name(entry),))]
    return tuple(dict.fromkeys(names))


def _si_name(name: str) -> str:
    """Return the parameter in m or rad that a name in mm or deg stands for."""
    si_names = {shown_parameter(known)[1]: known for known in RANGES}
    if name not in si_names:
        raise TrocarError(f"a setup has no parameter {name!r}; choose one of {', '.join((*GROUPS, *si_names))}")
    return si_names[name]


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    """Return parameter and bounds, in m or rad, from ``NAME=LOW:HIGH`` in mm or deg."""
    name, equals, ends = text.partition("=")
    try:
        if not equals:
            raise ValueError
        si_name = _si_name(name)
        low, high = (float(end) / shown_parameter(si_name)[0] for end in ends.split(":"))
    except ValueError:
        raise TrocarError(f"the bound is {text!r}; give NAME=LOW:HIGH, such as circle_radius_mm=25:35") from None
    check_bounds(si_name, low, high)
    return si_name, (low, high)


def _in_mm_and_deg(chosen: Preset, name: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Return a free parameter with its bounds, its initial and its final value, in mm or deg."""
    scale, said = shown_parameter(name)
    ends = {"from": parameters_of(chosen.setup)[name], **values}
    return {"name": said, **{key: scale * ends[key] for key in ("from", "to", "low", "high")}}


def _save(out: Path, best: DexterityMap, plan: SuturePlan, summary: dict[str, Any]) -> list[str]:
    """Write the setup and the picture of its plan; return their paths."""
    from trocar.tasks.suture.report.plan.circle import draw_plan

    names = [str(out / "setup.json"), str(draw_plan(best, plan, out / "plan.png"))]
    write_json(out / "setup.json", {**summary, "files": names}, KIND)
    return names


def _print(summary: dict[str, Any]) -> None:
    """Print the setup found and the command that plans with it."""
    from trocar.tasks.suture.report.plan.tables import setup_table
    from trocar.tasks.suture.report.plan.tissue import tissue_warnings

    console = results()
    console.print(setup_table(summary["free"]))
    was = f"{summary['start_reward']:.4f}" if summary["start_feasible"] else "no feasible plan"
    console.print(f"worst suture {summary['reward']:.4f}, with the preset {was}, at the same scale")
    console.print(summary["certified"])
    heuristic = "evaluations" in summary
    done = counted(summary["evaluations"], "setup") if heuristic else counted(summary["boxes"], "box", "boxes")
    console.print(f"{done} in {summary['seconds']:.1f} s")
    console.print(f"manipulability: {summary['manipulability_source']}")
    for warning in tissue_warnings(summary):
        console.print(warning)
    console.print(f"to plan there (with its own scale): {summary['command']}", soft_wrap=True)
    if "files" in summary:
        console.print("files: " + ", ".join(summary["files"]), soft_wrap=True)
