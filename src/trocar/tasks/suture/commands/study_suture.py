"""``trocar study suture``: the paper's Table I and Figs. 3 to 7, and how they look for random setups."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.cli.terminal import details, results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import PICTURE, write_json
from trocar.tasks.suture.commands import suture_options as options
from trocar.tasks.suture.planning import PRESETS

KIND = "study of sutures"
DRAWN = ("figures", "table_1", *(f"figure_{number}" for number in range(3, 8)))
FILES = {"summary.json": KIND, **{f"{name}.png": PICTURE for name in DRAWN}}
"""The files that are written, with their kinds."""

if TYPE_CHECKING:
    from trocar.tasks.suture.planning.random_setups import SetupStatistics

TWO_SWITCHES_SHARE = 0.95
"""Share of random setups in which the better direction should change exactly twice."""


def suture(
    *,
    preset: options.PresetName = "paper-demo",
    setups: Annotated[int, typer.Option(help="Number of random setups; 0 leaves them out.")] = 300,
    demonstrations: options.DemonstrationsPath = None,
    positions: Annotated[int, typer.Option(help="Number of grid positions for the preset, a multiple of four.")] = 360,
    seed: Annotated[int, typer.Option(help="Seed of the random setups.")] = 0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Save summary.json and Figs. 3 to 7 here.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Print Table I of the circle-suture paper beside ours, the changes of direction, and random setups."""
    from trocar.tasks.suture.planning.study import study
    from trocar.tasks.suture.planning.table_fits import table_fits
    from trocar.tasks.suture.report.plan.summary import finite

    chosen = options.chosen(PRESETS, preset, "preset")
    check_out_folder(out, FILES)
    if seed < 0 or setups < 0:
        what, value = ("seed", seed) if seed < 0 else ("number of setups", setups)
        raise TrocarError(f"the {what} is {value}; give 0 or more")
    recorded = options.recorded(demonstrations)
    given = {"manipulability_at": recorded.manipulability_at, "source": recorded.source} if recorded else {}
    found = study(chosen.setup, chosen.reward, positions, **given)
    started = time.perf_counter()
    statistics = _random(setups, seed) if setups else None
    fits = [fit.summary() for fit in table_fits()]
    summary: dict[str, Any] = {"study": "suture", "preset": preset, **found.summary(), "table_fits": fits}
    if recorded is not None:
        best = recorded.per_arm_at(found.thetas_rad).argmax(1)
        summary |= {
            "manipulability_highest_at_deg": np.degrees(found.thetas_rad[best]).tolist(),
            "assistant_source": recorded.source if len(best) > 1 else "no demonstrations of a second arm",
        }
    if statistics is not None:
        summary["random_setups"] = {"seed": seed, **statistics.summary()}
        summary["random_setups"]["compute_s"] = time.perf_counter() - started
    summary = finite(summary)
    if out is not None:
        from trocar.tasks.suture.report.plan.panels import draw_study

        summary["files"] = [str(out / "summary.json"), *map(str, draw_study(found, out, recorded))]
        write_json(out / "summary.json", summary, KIND)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary)


def _random(setups: int, seed: int) -> SetupStatistics:
    """Return statistics over random setups, with a progress bar."""
    from trocar.tasks.suture.planning.random_setups import random_statistics

    with progress() as tick:

        def listen(done: int, total: int) -> None:
            tick("feasible random setups", done, total)

        return random_statistics(np.random.default_rng(seed), setups, progress=listen)


def _print(summary: dict[str, Any]) -> None:
    """Print the tables, and which conclusions they support."""
    from trocar.tasks.suture.report.plan.tables import (
        choices_table,
        fits_table,
        gains_table,
        points_table,
        spread_table,
        sweep_table,
    )

    console = details()
    table = summary["table_1"]
    console.print(points_table(table["points"], table["paper_points"]))
    console.print(gains_table(table["gains"], table["paper_gains"]))
    switches, paper = (", ".join(f"{a:.4g}" for a in summary[key]) for key in ("switches_deg", "paper_switches_deg"))
    console.print(f"the better direction changes at {switches} deg (paper {paper})")
    angles = " / ".join(f"{angle:.0f}" for angle in summary["largest_wrist_deg"])
    limits = " / ".join(f"{angle:.0f}" for angle in summary["wrist_limits_deg"])
    console.print(f"largest roll / wrist pitch / wrist yaw: {angles} deg, limits {limits} deg")
    console.print(
        f"positions where the chosen direction is beyond a limit: {summary['infeasible_positions']} "
        f"of {summary['positions']}"
    )
    console.print(sweep_table(summary["lambda_sweep"]))
    console.print(_swept(summary))
    console.print(f"manipulability, arm 1: {summary['manipulability_source']}; arm 2: {summary['assistant_source']}")
    if "random_setups" in summary:
        random = summary["random_setups"]
        console.print(choices_table(random))
        console.print(
            f"{counted(random['setups'], 'feasible setup')} of {random['drawn']} drawn in {random['compute_s']:.1f} s; "
            f"feasible: {random['feasible_means']}. wrong: the infeasible direction was chosen, of "
            f"{random['one_way_positions']} positions with exactly one feasible direction. "
            "nearest: largest difference of Table I from the paper's in "
            "the setup that comes nearest to it."
        )
        console.print(_switched(random, summary["margin"]))
        console.print(spread_table(random))
    console.print(fits_table(summary["table_fits"]))
    results().print(_identified(summary))
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


def _switched(random: dict[str, Any], margin: str) -> str:
    """Return in words which formulas nearly always change direction twice, and how certain that is."""
    from trocar.eval.statistics import wilson_interval  # SciPy only when needed

    shown = []
    for enough, words in ((True, "at least"), (False, "less than")):
        names = [
            name for name, of in random["measures"].items() if (of["two_switches"] >= TWO_SWITCHES_SHARE) == enough
        ]
        if names:
            shown.append(f"in {words} {100 * TWO_SWITCHES_SHARE:.0f} % with {', '.join(names)}")
    of, count = random["measures"][margin], random["setups"]
    if kept := of["setups_where_no_choice_is_wrong"]:
        share, right = _percent(of["two_switches"]), _percent(of["two_switches_where_no_choice_is_wrong"])
        shown.append(
            f"with the preset's, {margin}, in {share}, and in {right} of the {kept} setups without a wrong choice"
        )
    low, high = wilson_interval(round(random["measures"]["default"]["two_switches"] * count), count)
    return (
        f"two changes {'; '.join(shown)}. Other seeds draw other setups: the 95 % interval of the default is "
        f"{100 * low:.1f} to {100 * high:.1f} %."
    )


def _percent(share: float) -> str:
    """Return a share as text."""
    return f"{100 * share:.1f} %"


def _identified(summary: dict[str, Any]) -> str:
    """Return in words what Table I does not identify, with the figures that show it."""
    fits = summary["table_fits"]
    largest = max(fit["largest_difference_points"] for fit in fits)
    said = (
        f"Table I identifies neither the setup nor the formula: {len(fits)} setups with different bases, needles and "
        f"grasps, one for each margin formula, come within {largest:.1f} points of each entry"
    )
    if "random_setups" not in summary:
        return said
    measures = summary["random_setups"]["measures"]
    within = {name: measure["paper_entries_within_p10_p90"] for name, measure in measures.items() if name != "default"}
    shown = ", ".join(f"{name} {count}" for name, count in within.items())
    return f"{said}; of its five free entries, these many lie between percentiles 10 and 90 of random setups: {shown}"
