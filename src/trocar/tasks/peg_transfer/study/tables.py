"""Tables II to IV beside the paper's rows, and the hypotheses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table

from trocar.eval.statistics import wilson_interval
from trocar.report.tables import figure
from trocar.tasks.peg_transfer.report import PAPER
from trocar.tasks.peg_transfer.study.hypotheses import Finding
from trocar.tasks.peg_transfer.study.published import COLLISIONS, TABLES

HEAD = ("method", "transfers", "success %", "of available", "transfer s", "path m", "collisions")
AVAILABLE = HEAD.index("of available")
"""This column is only in the page and in ``summary.json``, because it does not fit into 80 characters."""


def cell_rows(variant: str, cells: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the lines of the table of a variant: our cells, then the paper's rows as published."""
    lines = [_line(cell) for cell in cells if cell["variant"] == variant]
    for row in PAPER.get(variant, ()):
        median = COLLISIONS.get(row.who)
        lines.append(
            (
                f"paper: {row.who}",
                f"{row.succeeded} of {row.attempted}",
                rate(row.succeeded, row.attempted, wilson_interval(row.succeeded, row.attempted)),
                "",
                figure(row.mean_time_s),
                "",
                "" if median is None else f"median {median}",
            )
        )
    return lines


def _line(cell: Mapping[str, Any]) -> tuple[str, ...]:
    available = cell["available"]
    return (
        cell["method"],
        f"{cell['succeeded']} of {cell['attempted']}",
        rate(cell["succeeded"], cell["attempted"], cell["success_ci95"]),
        f"{cell['succeeded']} of {available}",
        with_interval(cell["mean_time_s"]),
        with_interval(cell["path_m"]),
        with_interval(cell["collisions_per_trial"]),
    )


def rate(succeeded: int, attempted: int, interval: Sequence[float]) -> str:
    """Return a success rate with its 95 % interval, in %."""
    low, high = interval
    return f"{100 * succeeded / attempted:.1f} [{100 * low:.0f}, {100 * high:.0f}]" if attempted else "-"


def with_interval(estimate: Mapping[str, Any]) -> str:
    """Return a mean with half the width of its interval."""
    if estimate["low"] is None:
        return figure(estimate["mean"])
    return f"{estimate['mean']:.2f} ± {(estimate['high'] - estimate['low']) / 2:.2f}"


def variant_table(variant: str, cells: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of a variant."""
    ours = next(cell for cell in cells if cell["variant"] == variant)
    table = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=0,
        title=f"{TABLES.get(variant, variant)}, {variant}: {ours['trials']} trials in {ours['sessions']} sessions "
        "each, simulated; the paper's rows as published",
        caption="95 % intervals count sessions; those of the paper's rows count attempts. A trial that fails "
        "early is short: times of methods that fail are not comparable",
    )
    for place, name in enumerate(HEAD):
        if place != AVAILABLE:
            table.add_column(name, justify="right" if place else "left", no_wrap=place > 0)
    for line in cell_rows(variant, cells):
        style = "dim" if line[0].startswith("paper") else "bold"
        table.add_row(*line[:AVAILABLE], *line[AVAILABLE + 1 :], style=style)
    return table


def hypothesis_rows(found: Sequence[Finding]) -> list[tuple[str, ...]]:
    """Return a line for each comparison."""
    return [
        (
            finding.hypothesis,
            finding.variant,
            finding.claim,
            f"{finding.difference:.3g}" + ("" if finding.low is None else f" [{finding.low:.3g}, {finding.high:.3g}]"),
            "-" if finding.p_adjusted is None else f"{finding.p_adjusted:.2g}",
            finding.verdict,
        )
        for finding in found
    ]


HYPOTHESIS_HEAD = ("", "variant", "claim", "difference", "p, Holm", "verdict")


def hypothesis_table(found: Sequence[Finding]) -> Table:
    """Return the table of the hypotheses."""
    table = Table(title="H1 to H4 between our conditions", box=box.SIMPLE, padding=(0, 1, 0, 0))
    for name in HYPOTHESIS_HEAD:
        table.add_column(name)
    for line in hypothesis_rows(found):
        table.add_row(*line)
    return table
