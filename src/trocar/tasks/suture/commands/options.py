"""What the suture commands share: options, in degrees and mm, what they stand for, and a table of results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.table import Table

from trocar.arms import ARMS
from trocar.errors import InvalidValue, UnknownName
from trocar.geometry import TURN
from trocar.tasks.suture.demonstrations import Demonstrations, load_demonstrations, synthetic_demonstrations
from trocar.tasks.suture.planning import PRESETS, Spacing, plan_even, plan_gaps
from trocar.tasks.suture.planning.plan import Planner

T = TypeVar("T")

REWARD, SPACING, GIVEN = "Reward", "Positions of the sutures", "Arm, circle, needle (default: the preset's)"


def option(group: str, help: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Return a documented option of a group."""
    return typer.Option(*([name] if name else []), help=help, metavar=metavar, rich_help_panel=group)


PresetName = Annotated[str, typer.Option("--preset", help=f"Initial setup and reward: {', '.join(PRESETS)}.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Save results and pictures here.")]
ArmName = Annotated[str | None, option(GIVEN, f"Arm that sutures: {', '.join(ARMS)}.", name="--arm")]
MinGap = Annotated[float | None, option(SPACING, "Smallest gap of neighbours; default: even.", "DEG", "--min-gap-deg")]
MaxGap = Annotated[float | None, option(SPACING, "Largest gap of neighbours; default: even.", "DEG", "--max-gap-deg")]
DemonstrationsPath = Annotated[
    str | None,
    option(REWARD, "Recorded sutures for the manipulability (a manifest or its folder), or `synthetic`.", "PATH"),
]


def pick(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise UnknownName."""
    if name not in table:
        raise UnknownName(f"the {what}", name, table)
    return table[name]


def recorded(demonstrations: str | None) -> Demonstrations | None:
    """Return the demonstrations at this path, or the synthetic ones; None if no path is given."""
    if demonstrations is None:
        return None
    return synthetic_demonstrations() if demonstrations == "synthetic" else load_demonstrations(demonstrations)


def in_si(name: str, value: float) -> float:
    """Return the value of a parameter in m or rad, given in mm or deg."""
    return math.radians(value) if name.endswith("_rad") else value / 1e3


def spacing_of(
    count: int,
    positions: int,
    min_gap_deg: float | None,
    max_gap_deg: float | None,
    forbid_deg: Sequence[str] = (),
    fix_deg: Sequence[float] = (),
) -> Spacing | None:
    """Return the constraints on the positions; None for the paper's even spacing.

    A bound that is not given is free (one step of the grid, a whole turn) if the other is given; else all gaps are
    equal.
    """
    if min_gap_deg is None and max_gap_deg is None and not (forbid_deg or fix_deg):
        return None
    free = min_gap_deg is not None or max_gap_deg is not None
    low, high = (TURN / positions, TURN) if free else (TURN / max(count, 1),) * 2
    min_gap = low if min_gap_deg is None else math.radians(min_gap_deg)
    max_gap = high if max_gap_deg is None else math.radians(max_gap_deg)
    fixed = tuple(math.radians(angle) for angle in fix_deg)
    return Spacing(min_gap, max_gap, tuple(_arc(text) for text in forbid_deg), fixed)


def _arc(text: str) -> tuple[float, float]:
    """Return a forbidden arc in rad from ``FROM:TO`` in degrees."""
    try:
        start, end = (math.radians(float(part)) for part in text.split(":"))
    except ValueError:
        remedy = "give two angles in deg as FROM:TO, such as 10:40"
        raise InvalidValue("the forbidden arc", repr(text), remedy) from None
    return start, end


def planner_of(count: int, spacing: Spacing | None) -> Planner:
    """Return the planner on the grid: of evenly spaced sutures, or of those with this spacing."""
    return partial(plan_even, count=count) if spacing is None else partial(plan_gaps, count=count, spacing=spacing)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], text: int = 1) -> Table:
    """Return a table whose first ``text`` columns are text, and the others numbers."""
    found = Table(title=title)
    for number, column in enumerate(columns):
        found.add_column(column, justify="left" if number < text else "right", no_wrap=True)
    for row in rows:
        found.add_row(*row)
    return found


def points_table(points: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return Table I beside the paper's, entries by location and allowed directions; 100 is the best plan of each."""
    rows = [
        (location, allowed, f"{ours:.1f}", f"{paper[location][allowed]:.1f}", f"{ours - paper[location][allowed]:+.1f}")
        for location, row in points.items()
        for allowed, ours in row.items()
    ]
    columns = ("location", "directions", "ours", "paper", "difference")
    return table("Table I: points, the best plan 100", columns, rows, text=2)


def files_line(summary: Mapping[str, Any]) -> list[str]:
    """Return a line that names the files that were written, if any were."""
    return ["files: " + ", ".join(summary["files"])] if "files" in summary else []
