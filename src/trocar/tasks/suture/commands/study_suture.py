"""``trocar study suture``: the paper's Table I and Figs. 3 to 7 beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer
from rich.table import Table

from trocar.cli.group import Result
from trocar.cli.out_folder import check_out_folder
from trocar.cli.terminal import rich_table
from trocar.files.output import PICTURE, write_json
from trocar.log import plain
from trocar.tasks.suture.commands import options
from trocar.tasks.suture.planning import dexterity

KIND = "study of sutures"
DRAWN = ("figures", "table_1", *(f"figure_{number}" for number in range(3, 8)))
FILES = {"summary.json": KIND, **{f"{name}.png": PICTURE for name in DRAWN}}
"""The files that are written, with their kinds."""
CAVEAT = (
    "Table I identifies neither the setup nor the formula: other bases, needles and grasps come within 1.9 points of "
    "each entry with each formula of the margin (docs/sutures.md)"
)


def suture(
    *,
    preset: options.PresetName = "paper-demo",
    demonstrations: options.DemonstrationsPath = None,
    positions: Annotated[int, typer.Option(help="Number of grid positions, a multiple of four.")] = 360,
    out: options.Out = None,
) -> Result:
    """Print Table I of the circle-suture paper beside ours, the changes of direction, and the sweep over lambda."""
    from trocar.tasks.suture.planning.study import study

    chosen = options.chosen_preset(preset, None)
    check_out_folder(out, FILES)
    all_round = dexterity(chosen.setup, chosen.reward, positions, options.recorded(demonstrations))
    found = study(all_round, chosen.fitted)
    summary: dict[str, Any] = plain({"study": "suture", "preset": preset, **found.summary()})
    if out is not None:
        from trocar.tasks.suture.report.panels import draw_study

        summary["files"] = [str(out / "summary.json"), *map(str, draw_study(found, out))]
        write_json(out / "summary.json", summary, KIND)
    return Result(summary, [CAVEAT, *options.files_line(summary)], _tables(summary))


def _tables(summary: dict[str, Any]) -> list[Any]:
    """Return the tables, and which conclusions they support."""
    found, sweep = summary["table_1"], summary["lambda_sweep"]
    switches, paper = (", ".join(f"{a:.4g}" for a in summary[key]) for key in ("switches_deg", "paper_switches_deg"))
    angles, limits = (" / ".join(f"{a:.0f}" for a in summary[key]) for key in ("largest_wrist_deg", "wrist_limits_deg"))
    columns = ("lambda", *(f"{weight:g}" for weight in sweep["weights"]))
    row = ("theta", *(f"{angle:.4g}" for angle in sweep["best_theta_deg"]))
    title = "Fig. 7: theta of the first suture, deg, of the best plan at each lambda"
    return [
        *options.fitted_line(summary["fitted"]),
        options.points_table(found["points"], found["paper_points"]),
        _gains_table(found["gains"], found["paper_gains"]),
        f"the better direction changes at {switches} deg (paper {paper})",
        f"largest roll / wrist pitch / wrist yaw: {angles} deg, limits {limits} deg",
        f"positions where the chosen direction is beyond a limit: {summary['infeasible_positions']} "
        f"of {summary['positions']}",
        rich_table(title, columns, [row], text=1),
        _swept(summary),
        f"manipulability: {summary['manipulability_source']}",
    ]


def _gains_table(gains: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return the best plan's gains over baselines, ours and of the paper's Table I, whose text calls points percent."""
    rows = []
    for name, ours in gains.items():
        both = (ours, paper[name])
        ratios = ("-" if gain["ratio_percent"] is None else f"{gain['ratio_percent']:.1f} %" for gain in both)
        rows.append([name, *(f"{gain['points']:.1f}" for gain in both), *ratios])
    return rich_table("Gain of the best plan", ("over", "points", "paper", "ratio", "paper"), rows, text=1)


def _swept(summary: dict[str, Any]) -> str:
    """Return in words how the best plan moves with lambda, and whether that reproduces the paper."""
    sweep = summary["lambda_sweep"]
    angles, (start, end) = sweep["best_theta_deg"], sweep["paper_best_theta_deg"]
    found, range_deg = sweep["like_paper_weights"], f"{min(start, end):.4g} to {max(start, end):.4g}"
    where = "" if found is None else f" from lambda {found[0]:g} to {found[1]:g}"
    return (
        f"with lambda the best plan turns by {sweep['travel_deg']:+.4g} deg, from {angles[0]:.4g} to {angles[-1]:.4g} "
        f"(plans 90 deg apart are the same); the paper's turns from {start:.4g} to {end:.4g}, at values of lambda that "
        f"it does not give: {'not ' if found is None else ''}reproduced{where}; at lambda {summary['weight']:g} the "
        f"best plan starts at {summary['best_theta_deg']:.4g} deg (paper {range_deg})"
    )
