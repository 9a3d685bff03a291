"""``trocar plan setup``: the circle, port and grasp whose best plan of sutures scores highest."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.cli.group import Result
from trocar.cli.options import Seed
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.counting import counted
from trocar.errors import InvalidValue, UnknownName
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.planning import PRESETS, SutureSetup, dexterity
from trocar.tasks.suture.planning.setup import SEARCHED, parameters_of, shown_parameter

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
            help="What may change, repeatable: circle, port, grasp, or a parameter such as base_tilt_deg; "
            "default: all three groups.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter, such as circle_radius_mm=25:35."),
    ] = None,
    evaluations: Annotated[int, typer.Option(help="Approximate number of setups to evaluate.")] = 2000,
    seed: Seed = 0,
    arm: options.ArmName = None,
    count: Annotated[int, typer.Option(help="Number of sutures.")] = 4,
    min_gap_deg: options.MinGap = None,
    max_gap_deg: options.MaxGap = None,
    out: options.Out = None,
) -> Result:
    """Search for the circle, port and grasp whose best plan of sutures scores highest.

    For each setup the plan is the best on its grid; over setups the search is heuristic. Rewards are scaled as for the
    preset. Exit code 1: no feasible plan was found.
    """
    from trocar.tasks.suture.planning.setup_search import CERTIFIED, GROUPS, search_setup
    from trocar.tasks.suture.planning.summary import finite, tissue_summary

    chosen = options.pick(PRESETS, preset, "preset")
    check_out_folder(out, FILES)
    names = [name for entry in free or GROUPS for name in GROUPS.get(entry) or (_si_name(entry, (*GROUPS,)),)]
    planner = options.planner_of(count, options.spacing_of(count, POSITIONS, min_gap_deg, max_gap_deg))
    with progress() as tick:
        found = search_setup(
            dexterity(chosen.setup, chosen.reward, POSITIONS),
            list(dict.fromkeys(names)),
            rng=np.random.default_rng(seed),
            setup=chosen.setup if arm is None else replace(chosen.setup, arm=options.pick(ARMS, arm, "arm")),
            bounds=dict(_bound(text) for text in bound or ()),
            planner=planner,
            evaluations=evaluations,
            progress=lambda done, total: tick("setups", done, total),
        )
    asked = {"--arm": arm, "--min-gap-deg": min_gap_deg, "--max-gap-deg": max_gap_deg}
    words = [f"--preset {preset}", f"--count {count}", *(f"{flag} {x}" for flag, x in asked.items() if x is not None)]
    was = parameters_of(chosen.setup)
    summary: dict[str, Any] = {
        "preset": preset,
        "start_reward": found.start.reward,
        "start_feasible": found.start.feasible,
        "reward": found.plan.reward,
        "feasible": found.plan.feasible,
        "holdable": found.best.setup.grasp.holdable,
        "evaluations": found.evaluations,
        "certified": CERTIFIED,
        "free": [
            _in_mm_and_deg(name, {"from": was[name], "to": value, "low": low, "high": high})
            for (name, value), (low, high) in zip(found.values.items(), found.bounds.values(), strict=True)
        ],
        "positions_deg": np.degrees(found.plan.positions_rad).round(9).tolist(),
        "directions": found.plan.directions.tolist(),
        **tissue_summary(found.best.setup, found.plan),
        "manipulability_source": found.best.source,
        "command": " ".join(["trocar plan suture", *words, *as_options(found.best.setup, chosen.setup)]),
    }
    summary = finite(summary)
    if out is not None:
        from trocar.tasks.suture.report.circle import draw_plan

        summary["files"] = [str(out / "setup.json"), str(draw_plan(found.best, found.plan, out / "plan.png"))]
        write_json(out / "setup.json", summary, KIND)
    return Result(summary, _lines(summary), succeeded=found.plan.feasible)


def as_options(setup: SutureSetup, preset: SutureSetup) -> list[str]:
    """Return the options of ``plan suture`` that turn a preset's setup into this one, apart from arm and insertion."""
    was, now = parameters_of(preset), parameters_of(setup)
    texts = []
    for name, value in now.items():
        scale, said = shown_parameter(name)
        if scale * abs(value - was[name]) > 1e-9:
            texts.append(f"--{said.replace('_', '-')} {scale * value:.9g}")
    was_mm, now_mm = (1e3 * one.circle.T_world_circle.translation_m for one in (preset, setup))
    if np.abs(now_mm - was_mm).max() > 1e-9:
        texts.append("--center-mm " + " ".join(f"{value:.9g}" for value in now_mm))
    return texts


def _si_name(name: str, groups: tuple[str, ...] = ()) -> str:
    """Return the parameter in m or rad that a name in mm or deg stands for."""
    si_names = {shown_parameter(known)[1]: known for known in SEARCHED}
    if name not in si_names:
        raise UnknownName("the parameter of a setup", name, (*groups, *si_names))
    return si_names[name]


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    """Return parameter and bounds, in m or rad, from ``NAME=LOW:HIGH`` in mm or deg."""
    name, _, ends = text.partition("=")
    try:
        low, high = (float(end) for end in ends.split(":"))
    except ValueError:
        remedy = "give NAME=LOW:HIGH, such as circle_radius_mm=25:35"
        raise InvalidValue("the bound", repr(text), remedy) from None
    si_name = _si_name(name)
    return si_name, (options.in_si(si_name, low), options.in_si(si_name, high))


def _in_mm_and_deg(name: str, values: dict[str, float]) -> dict[str, Any]:
    scale, said = shown_parameter(name)
    return {"name": said, **{key: scale * value for key, value in values.items()}}


def _lines(summary: dict[str, Any]) -> list[Any]:
    """Return the setup found and the command that plans with it, to be printed."""
    from trocar.tasks.suture.planning.summary import tissue_warnings

    was = f"{summary['start_reward']:.4f}" if summary["start_feasible"] else "no feasible plan"
    rows = [
        (number["name"].replace("_", " "), *(f"{number[key]:.1f}" for key in ("from", "to", "low", "high")))
        for number in summary["free"]
    ]
    return [
        options.table("The best setup found", ("parameter", "preset", "found", "from", "to"), rows),
        f"worst suture {summary['reward']:.4f}, with the preset {was}, at the same scale",
        f"{summary['certified']}; {counted(summary['evaluations'], 'setup')} evaluated",
        f"manipulability: {summary['manipulability_source']}",
        *tissue_warnings(summary),
        f"to plan there (with its own scale): {summary['command']}",
        *options.files_line(summary),
    ]
