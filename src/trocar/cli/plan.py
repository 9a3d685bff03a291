"""``trocar plan``: motions through waypoints, timed, with what they use of the limits."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.cli import plan_setup, plan_suture
from trocar.cli.grouped import GroupedCommand
from trocar.errors import TrocarError
from trocar.motion import PLANNERS, PlanQuality, assess_transfer, plan_transfer

app = typer.Typer(help="Plan motions and print their quality.", no_args_is_help=True, rich_markup_mode=None)

app.command("suture", cls=GroupedCommand, epilog="Example: trocar plan suture --preset paper-demo --out out/plan")(
    plan_suture.suture
)

app.command("setup", epilog="Example: trocar plan setup --free circle --free port --evaluations 1000")(plan_setup.setup)

T = TypeVar("T")

RANGE_SLACK = 0.02
"""Share of its range by which a joint of the given waypoints may leave it: the transfers recorded on a
real PSM
Classic reach q3 = 0.2403 m, beyond the nominal 0.24 m. What is used of it is printed."""


@app.command("transfer")
def transfer(
    waypoints: Annotated[
        Path, typer.Argument(help=".npy of shape (4, 6) or (n, 4, 6), or .npz with `waypoints`; rad and m.")
    ],
    planner: Annotated[str, typer.Option(help=f"How the motion is found: {', '.join(PLANNERS)}.")] = "spline",
    arm: Annotated[str, typer.Option(help=f"Whose kinematics and joint ranges: {', '.join(ARMS)}.")] = "psm-classic",
    limits: Annotated[
        str, typer.Option(help=f"Limits of velocity and acceleration: {', '.join(MOTION_LIMITS)}.")
    ] = "paper",
    up: Annotated[tuple[float, float, float], typer.Option(help="Direction of the pegs in the arm's base frame.")] = (
        0.0,
        0.0,
        1.0,
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Plan transfers through four waypoints each: grasp, lifted, over the target, lowered.

    Example: trocar plan transfer waypoints.npy --planner spline
    """
    model, motion_limits = _choice(ARMS, arm, "arm"), _choice(MOTION_LIMITS, limits, "set of limits")
    _choice(PLANNERS, planner, "planner")
    motions = []
    for index, four in enumerate(_load(waypoints)):
        try:
            plan = plan_transfer(model, four, motion_limits, up=up, planner=planner, range_slack=RANGE_SLACK)
        except TrocarError as error:
            raise TrocarError(f"{waypoints}, motion {index}: {error}") from None
        motions.append(assess_transfer(model, plan, motion_limits, up=up))
    summary = {
        "planner": planner,
        "arm": arm,
        "limits": limits,
        "mean_duration_s": float(np.mean([m.duration_s for m in motions])),
        "mean_bound_s": float(np.mean([m.bound_s for m in motions])),
        "motions": [asdict(m) for m in motions],
    }
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary, motions)


def _choice(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise with the names there are."""
    if name not in table:
        raise TrocarError(f"no {what} is called '{name}'; choose one of: {', '.join(table)}")
    return table[name]


def _load(path: Path) -> NDArray[np.float64]:
    """Return the waypoints of a file as (n, 4, 6)."""
    try:
        loaded: Any = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):
            with loaded:
                if "waypoints" not in loaded:
                    raise TrocarError(f"{path} holds {sorted(loaded)} but no array 'waypoints'; save one of that name")
                loaded = loaded["waypoints"]
        values = np.asarray(loaded, dtype=np.float64)
    except FileNotFoundError:
        raise TrocarError(f"there is no file {path}; give a .npy or .npz with waypoints") from None
    except TrocarError:
        raise
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        raise TrocarError(f"{path} cannot be read as a .npy or .npz of numbers; save the waypoints again") from None
    if values.ndim == 2:
        values = values[None]
    if values.ndim != 3 or values.shape[1:] != (4, 6) or not len(values):
        raise TrocarError(
            f"{path} has shape {np.shape(loaded)}; a transfer needs (4, 6) or (n, 4, 6): grasp, lifted, over "
            f"the target, lowered, six joints each"
        )
    return values


def _print(summary: dict[str, Any], motions: list[PlanQuality]) -> None:
    """Print the motions as a table."""
    table = Table(title=f"Transfers by '{summary['planner']}' for {summary['arm']}, limits '{summary['limits']}'")
    for column in (
        "motion",
        "duration s",
        "bound s",
        "compute ms",
        "velocity",
        "acceleration",
        "off vertical mm",
    ):
        table.add_column(column, justify="right", no_wrap=" " not in column)
    for index, m in enumerate(motions):
        table.add_row(
            str(index),
            f"{m.duration_s:.3f}",
            f"{m.bound_s:.3f}",
            f"{m.compute_ms:.1f}",
            f"{m.max_velocity_ratio:.3f}",
            f"{m.max_acceleration_ratio:.3f}",
            f"{1e3 * m.vertical_deviation_m:.2f}",
        )
    table.add_section()
    table.add_row("mean", f"{summary['mean_duration_s']:.3f}", f"{summary['mean_bound_s']:.3f}", "", "", "", "")
    console = Console()
    console.print(table)
    for index, m in enumerate(motions):
        for joint, excess in m.range_excess.items():
            console.print(f"Motion {index} leaves the nominal range of joint '{joint}' by {excess:.5f} (rad or m).")
    console.print(
        "Velocity and acceleration: largest share of the limits, checked at 1 kHz and at all knots. "
        "Bound: no motion through the same waypoints is shorter."
    )
