"""The study of the peg transfer beside Tables II to IV and Figures 9 to 11 of Hwang et al. 2022."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from trocar.eval.comparison import session_estimate
from trocar.eval.statistics import session_interval, wilson_interval
from trocar.eval.study import Results, TableData, TaskStudy
from trocar.report.tables import figure
from trocar.tasks.peg_transfer.report.hypotheses import NOTES, findings
from trocar.tasks.peg_transfer.report.peg_report import PAPER
from trocar.tasks.peg_transfer.report.study_figures import COLLISIONS, draw_motion, draw_paths, draw_performance
from trocar.tasks.peg_transfer.report.trial_row import KIND, Row, successes, transfer_time_s
from trocar.tasks.peg_transfer.task import VARIANTS

TABLES = {"unilateral": "Table II", "bilateral": "Table III", "handover": "Table IV"}

HEAD = ("method", "transfers", "success %", "of available", "transfer s", "path m", "collisions")


class PegStudy(TaskStudy[Row]):
    """Every method on every variant."""

    varied = "variant"
    values = VARIANTS
    kind = KIND
    notes = NOTES
    captions: ClassVar = {
        "paths.png": "Paths of the tips over the board, first trial of each condition (like Fig. 9 of the paper)",
        "performance.png": "Success, distance, collisions, completion time (like Fig. 10); people as published",
        "motion.png": "Velocity, acceleration, jerk from the measured joints (like Fig. 11)",
    }

    def figures(self, results: Results[Row]) -> dict[str, Any]:
        """Return the figures of a condition."""
        rows, (done, tried) = results.rows, successes(results)
        failures: Counter[str] = Counter()
        for row in rows:
            failures.update(row.failures)
        return {
            "attempted": sum(tried),
            "available": sum(row.available for row in rows),
            "succeeded": sum(done),
            "success_rate": sum(done) / sum(tried),
            "success_ci95": list(session_interval(done, tried)),
            "mean_time_s": _estimate(results, transfer_time_s),
            "completion_time_s": _estimate(results, lambda row: row.duration_s),
            "path_m": _estimate(results, lambda row: row.path_m),
            "collisions_per_trial": _estimate(results, lambda row: float(row.collisions)),
            "failures": dict(failures),
            "joints_rms": _means([row.joints for row in rows]),
            "tip_rms": _means([row.tip for row in rows]),
            "wall_s_per_trial": float(np.mean([row.wall_s for row in rows])),
        }

    def summary(self, results: Sequence[Results[Row]], cells: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the number of transfers, and what was found on H1 to H4."""
        found = [asdict(finding) for finding in findings(results)]
        return {"transfers": sum(cell["attempted"] for cell in cells), "hypotheses": found}

    def about(self, summary: Mapping[str, Any]) -> str:
        """Return a line below the title."""
        return (
            f"Simulated, {summary['transfers']} transfers in {summary['trials']} trials. The paper's rows (Hwang et "
            "al. 2022) are as published."
        )

    def tables(self, summary: Mapping[str, Any]) -> list[TableData]:
        """Return a table for each variant, and that of the hypotheses."""
        found = summary["hypotheses"]
        lines = [
            (
                one["hypothesis"],
                one["variant"],
                one["claim"],
                f"{one['difference']:.3g}" + ("" if one["low"] is None else f" [{one['low']:.3g}, {one['high']:.3g}]"),
                "-" if one["p_adjusted"] is None else f"{one['p_adjusted']:.2g}",
                one["verdict"],
            )
            for one in found
        ]
        head = ("", "variant", "claim", "difference", "p, Holm", "verdict")
        variants = dict.fromkeys(cell["variant"] for cell in summary["cells"])
        tables = [_variant_table(variant, summary["cells"]) for variant in variants]
        return tables + ([TableData("H1 to H4 between our conditions", head, lines)] if found else [])

    def pictures(self, folder: Path, results: Sequence[Results[Row]], summary: Mapping[str, Any]) -> list[Path]:
        """Draw figures like Figs. 9 to 11."""
        return [
            draw_performance(results, summary["cells"], folder / "performance.png"),
            draw_motion(results, folder / "motion.png"),
            draw_paths(results, folder / "paths.png"),
        ]


def _variant_table(variant: str, cells: Sequence[Mapping[str, Any]]) -> TableData:
    """Return our conditions of a variant, then the paper's rows as published."""
    ours = [cell for cell in cells if cell["variant"] == variant]
    lines = [
        (
            cell["method"],
            f"{cell['succeeded']} of {cell['attempted']}",
            _rate(cell["succeeded"], cell["attempted"], cell["success_ci95"]),
            f"{cell['succeeded']} of {cell['available']}",
            *(_with_interval(cell[key]) for key in ("mean_time_s", "path_m", "collisions_per_trial")),
        )
        for cell in ours
    ]
    for row in PAPER.get(variant, ()):
        median = COLLISIONS.get(row.who)
        lines.append(
            (
                f"paper: {row.who}",
                f"{row.succeeded} of {row.attempted}",
                _rate(row.succeeded, row.attempted, wilson_interval(row.succeeded, row.attempted)),
                "",
                figure(row.mean_time_s),
                "",
                "" if median is None else f"median {median}",
            )
        )
    title = f"{TABLES.get(variant, '')} {variant}: {ours[0]['trials']} trials in {ours[0]['sessions']} sessions each"
    caption = (
        "simulated; the paper's rows as published. 95 % intervals count sessions; those of the paper's rows count "
        "attempts. A trial that fails early is short: times of methods that fail are not comparable"
    )
    return TableData(title.strip(), HEAD, lines, caption, page_only=("of available",))


def _rate(succeeded: int, attempted: int, interval: Sequence[float]) -> str:
    low, high = interval
    return f"{100 * succeeded / attempted:.1f} [{100 * low:.0f}, {100 * high:.0f}]" if attempted else "-"


def _with_interval(estimate: Mapping[str, Any]) -> str:
    """Return a mean with half the width of its interval."""
    if estimate["low"] is None:
        return figure(estimate["mean"])
    return f"{estimate['mean']:.2f} ± {(estimate['high'] - estimate['low']) / 2:.2f}"


def _estimate(results: Results[Row], value: Callable[[Row], float]) -> dict[str, Any]:
    values = [value(row) for row in results.rows]
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return {**asdict(session_estimate(results.by_session(value))), "sd": sd, "median": float(np.median(values))}


def _means(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {kind: float(np.mean([row[kind] for row in rows])) for kind in rows[0]}
