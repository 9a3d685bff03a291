"""The study of debridement: one arm and two, all methods, beside Table I of Kehoe et al. 2014."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

from trocar.counting import counted
from trocar.eval.comparison import ratio_of_ratios
from trocar.eval.study import Results, RowKind, TableData, TaskStudy
from trocar.report.tables import figure
from trocar.tasks.debridement.report import ASSUMED
from trocar.tasks.debridement.report.charts import draw_failures, draw_times
from trocar.tasks.debridement.report.figures import Row, figures_of, row_of
from trocar.tasks.debridement.report.table_one import HEAD, MODES, SPEEDUP, TABLE_1, estimated, lines_of, within


class DebridementStudy(TaskStudy[Row]):
    """Every method with one arm and with two."""

    varied = "arms"
    values = (1, 2)
    kind = RowKind(Row, row_of)
    notes = (
        "rates: 95 % intervals of a beta-binomial over sessions; times and replans: Student's t over sessions; one arm "
        "against two: sessions resampled 10000 times, the same ones for both",
        "the paper's rates: Clopper-Pearson intervals, as if counted of its fragments, 60 of the robot and 30 of the "
        "person; within: whether our rate lies in that interval",
        *ASSUMED,
    )
    captions: ClassVar = {
        "times.png": "Time per fragment by part; pale: Table I as published",
        "failures.png": "The nine failure modes of section III-B",
    }

    def figures(self, results: Results[Row]) -> dict[str, Any]:
        """Return the figures of Table I, and which failure modes are within the paper's intervals."""
        figures = figures_of(results.rows)
        return figures | {"within_paper": {mode: within(results.condition.name, mode, figures) for mode in MODES}}

    def summary(self, results: Sequence[Results[Row]], cells: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the number of fragments, and how many times faster two arms were than one."""
        return {
            "fragments": sum(cell["fragments"] for cell in cells),
            "cleared": sum(cell["cleared"] for cell in cells),
            "speedups": speedups(results),
        }

    def about(self, summary: Mapping[str, Any]) -> str:
        """Return a line below the title."""
        return (
            f"Simulated, {summary['cleared']} of {summary['fragments']} fragments cleared in {summary['trials']} "
            "trials. The paper's columns (Kehoe et al. 2014, Table I) are as published."
        )

    def tables(self, summary: Mapping[str, Any]) -> list[TableData]:
        """Return Table I for each condition, and one arm against two."""
        tables = []
        for cell in summary["cells"]:
            what = f"Table I, {cell['variant'].replace('-', ' ')}, {cell['method']}"
            title = f"{what}: {counted(cell['trials'], 'trial')} in {counted(cell['sessions'], 'session')}"
            tables.append(TableData(title, HEAD, lines_of(cell["variant"], cell)))
        if summary["speedups"]:
            lines = [
                (one["method"], str(one["sessions"]), estimated(one["one_over_two"], 2), figure(one["paper"]))
                for one in summary["speedups"]
            ]
            head = ("method", "sessions", "s per fragment, one arm over two", "paper")
            tables.append(TableData("One arm against two", head, lines))
        return tables

    def remarks(self, summary: Mapping[str, Any]) -> list[str]:
        """Return a sentence for each condition that did not clear everything, or did not finish."""
        return left_behind(summary["cells"])

    def pictures(self, folder: Path, results: Sequence[Results[Row]], summary: Mapping[str, Any]) -> list[Path]:
        """Draw times and failures."""
        ours = [(cell["variant"], cell["method"], cell) for cell in summary["cells"]]
        return [draw_times(ours, folder / "times.png"), draw_failures(ours, folder / "failures.png")]


def speedups(results: Sequence[Results[Row]]) -> list[dict[str, Any]]:
    """Return, for each method run with both, how many times faster two arms were than one (VI-A: 1.5)."""
    one, two = ({r.condition.method: r for r in results if r.condition.name == variant} for variant in TABLE_1)
    found = []
    for method in one:
        if method in two:
            first, second = (by[method].by_session(lambda row: (row.duration_s, row.cleared)) for by in (one, two))
            ratio = ratio_of_ratios(first, second)
            sessions = len(first.keys() & second.keys())
            estimate = asdict(ratio) if ratio else None
            found.append({"method": method, "sessions": sessions, "one_over_two": estimate, "paper": SPEEDUP})
    return found


def left_behind(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each condition that did not clear everything, or did not finish."""
    found = []
    for cell in cells:
        left, stopped = cell["fragments"] - cell["cleared"], cell["unfinished_trials"]
        if left or stopped:
            why = ", ".join(f"{name.lower().replace('_', ' ')} {count}" for name, count in cell["left_behind"].items())
            found.append(
                f"{cell['variant'].replace('-', ' ')}, {cell['method']}: {left} of {cell['fragments']} fragments left "
                f"behind ({why}); {stopped} of {cell['trials']} trials stopped before their end"
            )
    return found
