"""``trocar plan``: motions through waypoints, timed, with what they use of the limits."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite, radians
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.cli.motion_file import require_motion_file, write_motions
from trocar.cli.plugin import Plugins
from trocar.cli.terminal import results
from trocar.errors import TrocarError
from trocar.files.reading import read_arrays
from trocar.motion import PLANNERS, ArmMotion, MotionPlan, MotionProblem, plan_motion, vertical_deviation_m

T = TypeVar("T")

UPRIGHT = (True, False, True)
"""The pieces of a transfer that are straight: the first lifts, the last lowers."""

MIN_STEP_MS = 0.1

RANGE_SLACK = 0.02
"""Share of its range by which a joint may leave it at the given waypoints: transfers recorded on a real PSM Classic
reach q3 = 0.2403 m, beyond the nominal 0.24 m. The command prints how much of it is used."""


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
    clearance_mm: Annotated[
        float, typer.Option(help="How far the tip may be off the verticals and the inner waypoints.")
    ] = 0.0,
    clearance_deg: Annotated[
        float, typer.Option(help="How far it may be turned there; 'relaxed' needs both to gain anything.")
    ] = 0.0,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Save the motions, sample by sample: .csv, .json or .npz.")
    ] = None,
    step_ms: Annotated[float, typer.Option(help="Time between samples in that file.")] = 10.0,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Plan transfers through four waypoints each: grasp, lifted, over the target, lowered.

    With a clearance, lifting and lowering must be straight within it. A motion that breaks what was asked is
    printed with the reason, and the exit code is then 1.
    """
    model, motion_limits = _choice(ARMS, arm, "arm"), _choice(MOTION_LIMITS, limits, "set of limits")
    PLANNERS.pick(planner)
    near = _tolerances(clearance_mm, clearance_deg)
    if not MIN_STEP_MS <= step_ms < np.inf:
        raise TrocarError(f"--step-ms {step_ms} is outside {MIN_STEP_MS}..inf; give the time between two samples")
    joints = [joint.name for joint in model.joints]
    if out is not None:
        require_motion_file(out, joints, [waypoints])
    motions, found = [], []
    for index, four in enumerate(_load(waypoints)):
        try:
            asked = ArmMotion(model, four, motion_limits, up=np.array(up), straight=UPRIGHT if near else ())
            plan = plan_motion(MotionProblem({arm: asked}, range_slack=RANGE_SLACK, **near), planner)
        except TrocarError as error:
            raise TrocarError(f"{waypoints}, motion {index}: {error}") from None
        motions.append(_record(asked, plan))
        found += [path.trajectory for path in plan.paths.values() if plan.found]
    summary = {
        "planner": planner,
        "arm": arm,
        "limits": limits,
        "mean_duration_s": _mean(motions, "duration_s"),
        "mean_bound_s": _mean(motions, "bound_s"),
        "motions": motions,
    }
    if out is not None and found:
        summary["out"] = str(write_motions(out, found, joints, 1e-3 * step_ms))
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _print(summary)
    if not all(motion["found"] for motion in motions):
        raise typer.Exit(1)


def _tolerances(clearance_mm: float, clearance_deg: float) -> dict[str, Any]:
    """Return the tolerances of a motion problem; empty without a clearance."""
    if not (clearance_mm or clearance_deg):
        return {}
    off_m, off_rad = 1e-3 * clearance_mm, radians(clearance_deg)
    return {
        "straight_tolerance_m": off_m,
        "straight_tolerance_rad": off_rad,
        "waypoint_tolerance_m": off_m,
        "waypoint_tolerance_rad": off_rad,
    }


def _record(asked: ArmMotion, plan: MotionPlan) -> dict[str, Any]:
    """Return the figures of one motion; None for those that are unknown because the planner found nothing."""
    told: dict[str, Any] = {
        "found": plan.found,
        "reason": plan.reason,
        "duration_s": plan.duration_s if isfinite(plan.duration_s) else None,
        "bound_s": plan.bound_s,
        "compute_ms": plan.compute_ms,
        "max_velocity_ratio": None,
        "max_acceleration_ratio": None,
        "vertical_deviation_m": None,
        "range_excess": {},
        "violations": [str(violation) for violation in plan.violations],
    }
    for name, path in plan.paths.items():
        use = plan.use[name]
        told["max_velocity_ratio"], told["max_acceleration_ratio"] = use.velocity_ratio, use.acceleration_ratio
        told["vertical_deviation_m"] = vertical_deviation_m(asked, path)
        excess = zip(asked.model.joints, use.range_excess.tolist(), strict=True)
        told["range_excess"] = {joint.name: beyond for joint, beyond in excess if beyond > 0}
    return told


def _mean(motions: list[dict[str, Any]], key: str) -> float | None:
    """Return the mean over the motions that were found; None if there are none."""
    values = [motion[key] for motion in motions if motion["found"]]
    return float(np.mean(values)) if values else None


def _choice(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise an error that lists the available names."""
    if name not in table:
        raise TrocarError(f"no {what} is called '{name}'; choose one of: {', '.join(table)}")
    return table[name]


def _load(path: Path) -> NDArray[np.float64]:
    """Return the waypoints of a file as (n, 4, 6)."""
    if path.is_dir():
        raise TrocarError(f"{str(path)!r} is a folder; give a .npy or .npz with waypoints")
    try:
        arrays = read_arrays(path)
    except FileNotFoundError:
        raise TrocarError(f"there is no file {path}; give a .npy or .npz with waypoints") from None
    except TrocarError:
        raise
    except (OSError, ValueError):
        raise TrocarError(f"{path} cannot be read as a .npy or .npz of numbers; save the waypoints again") from None
    try:
        loaded = arrays[""] if "" in arrays else arrays["waypoints"]
        values = loaded.astype(np.float64, casting="same_kind")
    except KeyError:
        raise TrocarError(f"{path} holds {sorted(arrays)} but no array 'waypoints'; save one of that name") from None
    except TypeError:
        raise TrocarError(f"{path} cannot be read as a .npy or .npz of numbers; save the waypoints again") from None
    if values.ndim == 2:
        values = values[None]
    if values.ndim != 3 or values.shape[1:] != (4, 6) or not len(values):
        raise TrocarError(
            f"{path} has shape {np.shape(loaded)}; a transfer needs (4, 6) or (n, 4, 6): grasp, lifted, over "
            f"the target, lowered, six joints each"
        )
    return values


def _print(summary: dict[str, Any]) -> None:
    """Print the motions as a table."""
    table = Table(title=f"Transfers by '{summary['planner']}' for {summary['arm']}, limits '{summary['limits']}'")
    columns = {
        "duration s": ("duration_s", 1.0, ".3f"),
        "bound s": ("bound_s", 1.0, ".3f"),
        "compute ms": ("compute_ms", 1.0, ".1f"),
        "velocity": ("max_velocity_ratio", 1.0, ".3f"),
        "acceleration": ("max_acceleration_ratio", 1.0, ".3f"),
        "off vertical mm": ("vertical_deviation_m", 1e3, ".2f"),
    }
    for column in ("motion", *columns):
        table.add_column(column, justify="right", no_wrap=" " not in column)
    for index, motion in enumerate(summary["motions"]):
        cells = (_cell(motion[key], scale, style) for key, scale, style in columns.values())
        table.add_row(str(index) if motion["found"] else f"{index} refused", *cells)
    table.add_section()
    means = (_cell(summary[key], 1.0, ".3f") for key in ("mean_duration_s", "mean_bound_s"))
    table.add_row("mean", *means, "", "", "", "")
    console = results()
    console.print(table)
    for index, motion in enumerate(summary["motions"]):
        if not motion["found"]:
            console.print(f"Motion {index}: {motion['reason']}.")
        for joint, excess in motion["range_excess"].items():
            console.print(f"Motion {index} leaves the nominal range of joint '{joint}' by {excess:.5f} (rad or m).")
    console.print(
        "Velocity and acceleration: largest share of the limits, checked at 1 kHz and at all knots. "
        "Bound: no motion through the same waypoints is shorter."
    )
    if "out" in summary:
        console.print(f"saved {summary['out']}: the motions that were found, in order", soft_wrap=True)


def _cell(value: float | None, scale: float, style: str) -> str:
    return "-" if value is None else format(scale * value, style)
