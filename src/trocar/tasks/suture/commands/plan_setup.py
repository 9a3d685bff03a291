"""``trocar plan setup``: the circle, port and grasp whose best plan of sutures scores highest."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer

from trocar.cli.group import Result
from trocar.cli.options import Seed
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.cli.terminal import rich_table
from trocar.counting import counted
from trocar.errors import InvalidValue, UnknownName
from trocar.files.output import PICTURE, write_json, write_text
from trocar.log import plain
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.planning import dexterity
from trocar.tasks.suture.planning.parameters import SAID, SEARCHED, parameters_of, shown_parameter
from trocar.tasks.suture.planning.settings import settings_between, setup_file

COARSE, FINER = 72, 5
"""Smallest grid during the search, and how many times finer the grid of the printed plan is."""
KIND = "setup for sutures"
SETUP_FILE = "setup.toml"
FILES = {"setup.json": KIND, SETUP_FILE: KIND, "plan.png": PICTURE}
"""The files that are written, with their kinds."""


def setup(
    *,
    preset: options.PresetName = "default",
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="What may change, repeatable: circle, port, grasp, puller (the second port), or a parameter such as "
            "base_tilt_deg; default: circle, port and grasp.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter, such as circle_radius_mm=25:35."),
    ] = None,
    evaluations: Annotated[int, typer.Option(help="Approximate number of setups to evaluate.")] = 2000,
    seed: Seed = 0,
    settings: options.Settings = None,
    arm: options.ArmName = None,
    count: options.Count = 4,
    search: options.Search = None,
    gap: options.Gap = None,
    out: options.Out = None,
) -> Result:
    """Search for the circle, port and grasp whose best plan of sutures scores highest.

    For each setup the plan is the best on its grid; over setups the search is heuristic. Rewards are scaled as for the
    preset. Exit code 1: no plan was found that is feasible and sound in the tissue.
    """
    from trocar.tasks.suture.planning.setup_search import CERTIFIED, GROUPS, USUAL, search_setup
    from trocar.tasks.suture.planning.summary import tissue_summary

    chosen = options.chosen_preset(preset, settings)
    start = options.chosen_preset(preset, settings, arm)
    check_out_folder(out, FILES)
    names = [name for entry in free or USUAL for name in GROUPS.get(entry) or (_si_name(entry, (*GROUPS,)),)]
    positions = FINER * options.grid_of(count, COARSE)
    planner = options.planner_of(count, options.spacing_of(count, search, gap, setup=start.setup))
    with progress() as tick:
        found = search_setup(
            dexterity(chosen.setup, chosen.reward, positions),
            list(dict.fromkeys(names)),
            rng=np.random.default_rng(seed),
            setup=start.setup,
            bounds=dict(_bound(text) for text in bound or ()),
            planner=planner,
            evaluations=evaluations,
            progress=lambda done, total: tick("setups", done, total),
        )
    best = replace(start, setup=found.best.setup)
    asked = {"--arm": arm, "--search": search, "--gap": gap}
    changes = settings_between(options.chosen_preset(preset, None).setup, best.setup)
    words = [f"--preset {out / SETUP_FILE if out else preset}", f"--count {count}"]
    words += [f"{flag} {x}" for flag, x in asked.items() if x is not None]
    if out is None:
        words += [f"--set {name}={value}" for name, value in changes.items()]
    was = parameters_of(start.setup)
    summary: dict[str, Any] = {
        "preset": preset,
        "start_reward": found.start.reward,
        "start_feasible": found.start.feasible,
        "reward": found.plan.reward,
        "feasible": found.plan.feasible,
        "sound": found.sound,
        "holdable": best.setup.grasp.holdable,
        "evaluations": found.evaluations,
        "certified": CERTIFIED,
        "free": [
            _in_mm_and_deg(name, {"from": was[name], "to": value, "low": low, "high": high})
            for (name, value), (low, high) in zip(found.values.items(), found.bounds.values(), strict=True)
        ],
        "positions_deg": np.degrees(found.plan.positions_rad).round(9).tolist(),
        "directions": found.plan.directions.tolist(),
        **tissue_summary(best.setup, found.plan),
        "manipulability_source": found.best.source,
        "command": " ".join(["trocar plan suture", *words]) if found.sound else None,
    }
    summary = plain(summary)
    if out is not None:
        from trocar.tasks.suture.report.circle import draw_plan

        files = [out / "setup.json", out / SETUP_FILE, draw_plan(found.best, found.plan, out / "plan.png")]
        summary["files"] = [str(file) for file in files]
        write_text(out / SETUP_FILE, setup_file(best), KIND)
        write_json(out / "setup.json", summary, KIND)
    return Result(summary, _lines(summary), succeeded=found.sound)


def _si_name(name: str, groups: tuple[str, ...] = ()) -> str:
    """Return the parameter in m or rad that a name in mm or deg stands for."""
    si_names = {said: known for said, known in SAID.items() if known in SEARCHED}
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
    scale = shown_parameter(si_name)[0]
    return si_name, (low / scale, high / scale)


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
        rich_table("The best setup found", ("parameter", "preset", "found", "from", "to"), rows, text=1),
        f"worst suture {summary['reward']:.4f}, with the preset {was}, at the same scale",
        f"{summary['certified']}; {counted(summary['evaluations'], 'setup')} evaluated",
        f"manipulability: {summary['manipulability_source']}",
        *tissue_warnings(summary),
        f"to plan there (with its own scale): {summary['command']}"
        if summary["sound"]
        else "no plan was found that can be recommended: "
        + ("sutures cross, or do not hold the mesh" if summary["feasible"] else "none is feasible")
        + "; free more parameters, widen their bounds or plan fewer sutures",
        *options.files_line(summary),
    ]
