"""``trocar study suture``: the paper's Table I and Figs. 3 to 7 beside ours."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from trocar.cli.out_folder import check_out_folder
from trocar.cli.terminal import details, results
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.planning import PRESETS, dexterity

KIND = "study of sutures"
DRAWN = ("figures", "table_1", *(f"figure_{number}" for number in range(3, 8)))
FILES = {"summary.json": KIND, **{f"{name}.png": PICTURE for name in DRAWN}}
"""The files that are written, with their kinds."""


def suture(
    *,
    preset: options.PresetName = "paper-demo",
    demonstrations: options.DemonstrationsPath = None,
    positions: Annotated[int, typer.Option(help="Number of grid positions, a multiple of four.")] = 360,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Print Table I of the circle-suture paper beside ours, the changes of direction, and the sweep over lambda."""
    from trocar.tasks.suture.planning.study import study
    from trocar.tasks.suture.report.plan_summary import finite

    chosen = options.pick(PRESETS, preset, "preset")
    check_out_folder(out, FILES)
    found = study(dexterity(chosen.setup, chosen.reward, positions, options.recorded(demonstrations)))
    summary: dict[str, Any] = finite({"study": "suture", "preset": preset, **found.summary()})
    if out is not None:
        from trocar.tasks.suture.report.panels import draw_study

        summary["files"] = [str(out / "summary.json"), *map(str, draw_study(found, out))]
        write_json(out / "summary.json", summary, KIND)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary)


def _print(summary: dict[str, Any]) -> None:
    """Print the tables, and which conclusions they support."""
    from trocar.tasks.suture.report.plan_tables import gains_table, points_table, sweep_table

    console, table = details(), summary["table_1"]
    console.print(points_table(table["points"], table["paper_points"]))
    console.print(gains_table(table["gains"], table["paper_gains"]))
    switches, paper = (", ".join(f"{a:.4g}" for a in summary[key]) for key in ("switches_deg", "paper_switches_deg"))
    console.print(f"the better direction changes at {switches} deg (paper {paper})")
    angles, limits = (" / ".join(f"{a:.0f}" for a in summary[key]) for key in ("largest_wrist_deg", "wrist_limits_deg"))
    console.print(f"largest roll / wrist pitch / wrist yaw: {angles} deg, limits {limits} deg")
    console.print(
        f"positions where the chosen direction is beyond a limit: {summary['infeasible_positions']} "
        f"of {summary['positions']}"
    )
    console.print(sweep_table(summary["lambda_sweep"]))
    console.print(_swept(summary))
    console.print(f"manipulability, arm 1: {summary['manipulability_source']}; arm 2: {summary['assistant_source']}")
    results().print(
        "Table I identifies neither the setup nor the formula: other bases, needles and grasps come within 1.9 points "
        "of each entry with each formula of the margin (docs/sutures.md)"
    )
    if "files" in summary:
        results().print("files: " + ", ".join(summary["files"]), soft_wrap=True)


def _swept(summary: dict[str, Any]) -> str:
    """Return in words how the best plan moves with lambda, and whether that reproduces the paper."""
    sweep = summary["lambda_sweep"]
    angles, (start, end) = sweep["best_theta_deg"], sweep["paper_best_theta_deg"]
    return (
        f"with lambda the best plan turns by {sweep['travel_deg']:+.4g} deg, from {angles[0]:.4g} to {angles[-1]:.4g} "
        f"(plans 90 deg apart are the same), the paper's by {end - start:+.4g}, from {start:.4g} to {end:.4g}, at "
        f"values of lambda that it does not give: {'reproduced' if sweep['reproduces_paper'] else 'not reproduced'}; "
        f"at lambda {summary['weight']:g} the best plan starts at {summary['best_theta_deg']:.4g} deg (paper "
        f"{min(start, end):.4g} to {max(start, end):.4g})"
    )
