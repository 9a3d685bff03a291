"""What the suture commands share: options, in degrees and mm, what they stand for, and a table of results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from trocar.arms import ARMS
from trocar.cli.terminal import rich_table
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import TURN
from trocar.tasks.suture.demonstrations import Demonstrations, load_demonstrations, synthetic_demonstrations
from trocar.tasks.suture.planning import PRESETS, Preset, Spacing, SutureSetup, plan_even, plan_gaps
from trocar.tasks.suture.planning.plan import Planner, check_count
from trocar.tasks.suture.planning.primitive import least_gap_rad
from trocar.tasks.suture.planning.settings import SETTINGS, preset_of, setting_of, with_settings

POSITIONS = 360
SEARCHES = ("even", "gaps")
GAP_SHARES = (2 / 3, 4 / 3)
"""Usual bounds of the gaps, as shares of an even gap: no part of the circle is left much weaker than another."""
REWARD, SPACING, SETUP = "Reward", "Positions of the sutures", "Setup (default: the preset's)"


def option(group: str, help: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Return a documented option of a group."""
    return typer.Option(*([name] if name else []), help=help, metavar=metavar, rich_help_panel=group)


PresetName = Annotated[
    str,
    typer.Option("--preset", help=f"Setup and reward: {', '.join(PRESETS)}, or a setup file (.toml).", metavar="NAME"),
]
Count = Annotated[int, typer.Option(help="Number of sutures.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Save results and pictures here.")]
Settings = Annotated[
    list[str] | None,
    option(
        SETUP,
        f"Change a number or a word of the setup; repeatable. Names: {', '.join(SETTINGS)}.",
        "NAME=VALUE",
        "--set",
    ),
]
ArmName = Annotated[str | None, option(SETUP, f"Arm that sutures: {', '.join(ARMS)}.", name="--arm")]
Search = Annotated[
    str | None,
    option(SPACING, "even: all gaps equal; gaps: bounded by --gap. Default: even, or gaps if --gap is given.", "WORD"),
]
Gap = Annotated[
    str | None,
    option(
        SPACING,
        "Bounds of the gaps of neighbours in deg; one may be left out. Default: 2/3 to 4/3 of an even gap, where no "
        "bites cross.",
        "LOW:HIGH",
    ),
]
DemonstrationsPath = Annotated[
    str | None,
    option(REWARD, "Recorded sutures for the manipulability (a manifest or its folder), or `synthetic`.", "PATH"),
]


def chosen_preset(name: str, settings: Sequence[str] | None, arm: str | None = None) -> Preset:
    """Return the preset of this name or file, with the given settings ``NAME=VALUE`` and arm."""
    return with_settings(preset_of(name), dict(setting_of(text) for text in settings or ()), arm)


def grid_of(count: int, at_least: int = POSITIONS) -> int:
    """Return the usual number of positions round the circle: a multiple of the number of sutures."""
    check_count(count)
    return count * -(-at_least // count)


def recorded(demonstrations: str | None) -> Demonstrations | None:
    """Return the demonstrations at this path, or the synthetic ones; None if no path is given."""
    if demonstrations is None:
        return None
    return synthetic_demonstrations() if demonstrations == "synthetic" else load_demonstrations(demonstrations)


def spacing_of(
    count: int,
    search: str | None,
    gap: str | None,
    forbid: Sequence[str] = (),
    fix_deg: Sequence[float] = (),
    *,
    setup: SutureSetup,
) -> Spacing | None:
    """Return the constraints on the positions; None for the paper's even spacing without any others.

    A bound of the gaps that is not given has its usual value, with which the sutures of this setup do not cross if such
    a placement exists.
    """
    kind = search or ("gaps" if gap else "even")
    if kind not in SEARCHES:
        raise UnknownName("the search", kind, SEARCHES)
    if kind == "even" and gap:
        raise InvalidInput(f"gaps of {gap} deg", "are no even ones", "drop --gap, or give --search gaps")
    if kind == "even" and not (forbid or fix_deg):
        return None
    even_rad = TURN / max(count, 1)
    low, high = (even_rad, even_rad) if kind == "even" else _bounds(gap or ":", even_rad, least_gap_rad(setup))
    fixed = tuple(math.radians(angle) for angle in fix_deg)
    return Spacing(low, high, tuple(_arc(text) for text in forbid), fixed)


def _bounds(text: str, even_rad: float, apart_rad: float) -> tuple[float, float]:
    """Return the bounds of the gaps in rad from ``LOW:HIGH`` in degrees; a missing bound has its usual value."""
    usual = (min(max(GAP_SHARES[0] * even_rad, apart_rad), even_rad), min(GAP_SHARES[1] * even_rad, TURN))
    parts = text.split(":")
    try:
        given = [math.radians(float(part)) if part else None for part in parts]
        low, high = (at if bound is None else bound for bound, at in zip(given, usual, strict=True))
    except ValueError:
        remedy = "give the smallest and the largest in deg as LOW:HIGH, such as 60:120 or 60:"
        raise InvalidValue("the gap", repr(text), remedy) from None
    # a usual bound gives way to a given one
    return (low, max(low, high)) if given[1] is None else (min(low, high) if given[0] is None else low, high)


def _arc(text: str) -> tuple[float, float]:
    """Return a forbidden arc in rad from ``FROM:TO`` in degrees."""
    try:
        start, end = (math.radians(float(part)) for part in text.split(":"))
    except ValueError:
        remedy = "give two angles in deg as FROM:TO, such as 10:40"
        raise InvalidValue("the forbidden arc", repr(text), remedy) from None
    return start, end


def planner_of(count: int, spacing: Spacing | None) -> Planner:
    """Return the planner of evenly spaced sutures, or of sutures with this spacing."""
    return partial(plan_even, count=count) if spacing is None else partial(plan_gaps, count=count, spacing=spacing)


def points_table(points: Mapping[str, Mapping[str, float]], paper: Mapping[str, Mapping[str, float]]) -> Table:
    """Return our Table I beside the paper's, by location and allowed directions; 100 is the best plan."""
    rows = [
        (location, allowed, f"{ours:.1f}", f"{paper[location][allowed]:.1f}", f"{ours - paper[location][allowed]:+.1f}")
        for location, row in points.items()
        for allowed, ours in row.items()
    ]
    columns = ("location", "directions", "ours", "paper", "difference")
    return rich_table("Table I: points, the best plan 100", columns, rows, text=2)


def fitted_line(fitted: Sequence[str]) -> list[str]:
    """Return a line that says what was fitted to the paper's figures, if anything was."""
    from trocar.tasks.suture.planning.study import fitted_note

    return [f"fitted: {fitted_note(fitted)}"] if fitted else []


def files_line(summary: Mapping[str, Any]) -> list[str]:
    """Return a line that names the files that were written, if any were."""
    return ["files: " + ", ".join(summary["files"])] if "files" in summary else []
