"""``trocar plan``: timed motions through waypoints, with their use of the limits."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from typer import Argument, Option

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.cli.group import Result
from trocar.cli.out_folder import require_file
from trocar.cli.terminal import rich_table
from trocar.errors import BadFile, InvalidInput, TrocarError, UnknownName
from trocar.files.archive import Archive
from trocar.files.output import write_table
from trocar.files.reading import read_numbers
from trocar.motion import PLANNERS, ArmMotion, MotionPlan, MotionProblem, plan_motion, vertical_deviation_m
from trocar.trajectory import Trajectory

MIN_STEP_MS = 0.1

KIND = "trocar motion"
ORDERS = ("position", "velocity", "acceleration")

RANGE_SLACK = 0.02
"""Share of its range by which a joint may leave it at the given waypoints: transfers recorded on a real PSM Classic
reach q3 = 0.2403 m, beyond the nominal 0.24 m. The command prints how much of it is used."""


def transfer(
    waypoints: Annotated[
        Path, Argument(help=".npy of shape (4, 6) or (n, 4, 6), or .npz with `waypoints`; rad and m.")
    ],
    planner: Annotated[str, Option(help=f"How the motion is found: {', '.join(PLANNERS)}.")] = "spline",
    arm: Annotated[str, Option(help=f"Whose kinematics and joint ranges: {', '.join(ARMS)}.")] = "psm-classic",
    limits: Annotated[str, Option(help=f"Limits of velocity and acceleration: {', '.join(MOTION_LIMITS)}.")] = "paper",
    up: Annotated[tuple[float, float, float], Option(help="Direction of the pegs in the arm's base frame.")] = (
        0.0,
        0.0,
        1.0,
    ),
    out: Annotated[
        Path | None, Option(metavar="FILE", help="Save the motions, sample by sample: .csv or .npz.")
    ] = None,
    step_ms: Annotated[float, Option(help="Time between samples in that file.")] = 10.0,
) -> Result:
    """Plan transfers through four waypoints each: grasp, lifted, over the target, lowered.

    A motion that breaks what was asked is printed with the reason, and the exit code is then 1.
    """
    model = ARMS.pick(arm)
    if limits not in MOTION_LIMITS:
        raise UnknownName("set of limits", limits, MOTION_LIMITS)
    PLANNERS.pick(planner)
    if not MIN_STEP_MS <= step_ms < np.inf:
        outside = f"is outside {MIN_STEP_MS}..inf"
        raise InvalidInput(f"--step-ms {step_ms}", outside, "give the time between two samples")
    joints = [joint.name for joint in model.joints]
    if out is not None:
        mark = ",".join(_columns(joints)) if out.suffix == ".csv" else ""
        require_file("--out", out, KIND, (".csv", ".npz"), [waypoints], mark)
    motions, found = [], []
    for index, four in enumerate(_load(waypoints)):
        try:
            asked = ArmMotion(model, four, MOTION_LIMITS[limits], up=np.array(up))
            plan = plan_motion(MotionProblem({arm: asked}, range_slack=RANGE_SLACK), planner)
        except TrocarError as error:
            raise InvalidInput(f"{waypoints}, motion {index}:", str(error)) from None
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
        summary["out"] = str(_write(out, found, joints, 1e-3 * step_ms))
    return Result(summary, _lines(summary), succeeded=all(motion["found"] for motion in motions))


def _record(asked: ArmMotion, plan: MotionPlan) -> dict[str, Any]:
    """Return the figures of one motion; None for what is unknown without a motion."""
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


def _columns(joints: Sequence[str]) -> list[str]:
    """Return the names of a table's columns: which motion, when, each joint's position, velocity, acceleration."""
    return ["motion", "t_s", *(f"{joint}_{order}" for joint in joints for order in ORDERS)]


def _write(path: Path, motions: Sequence[Trajectory], joints: Sequence[str], step_s: float) -> Path:
    """Write motions one after the other, each sampled from 0 s to its end; the last step may be shorter."""
    sampled = []
    for number, motion in enumerate(motions):
        times = np.append(np.arange(0.0, motion.duration_s, step_s), motion.duration_s)
        moved = (motion(motion.times_s[0] + times, order) for order in range(len(ORDERS)))
        sampled.append((np.full(len(times), number), times, *moved))
    numbers, times, *moved = (np.concatenate(arrays) for arrays in zip(*sampled, strict=True))
    if path.suffix == ".npz":
        header = {"format": KIND, "version": 1, "joints": list(joints)}
        return Archive(header, {"motion": numbers, "t_s": times, **dict(zip(ORDERS, moved, strict=True))}).save(path)
    by_joint = np.stack(moved, axis=-1).reshape(len(times), -1)
    rows = (
        [str(number), *(f"{value:.9g}" for value in (time_s, *row))]
        for number, time_s, row in zip(numbers, times, by_joint, strict=True)
    )
    return write_table(path, _columns(joints), rows)


def _load(path: Path) -> NDArray[np.float64]:
    """Return the waypoints of a file as (n, 4, 6)."""
    values = read_numbers(path, "waypoints", "waypoints")
    found = values[None] if values.ndim == 2 else values
    if found.ndim != 3 or found.shape[1:] != (4, 6) or not len(found):
        needs = "a transfer needs (4, 6) or (n, 4, 6): grasp, lifted, over the target, lowered, six joints each"
        raise BadFile(path, f"has shape {values.shape}", needs)
    return found


def _lines(summary: dict[str, Any]) -> list[Any]:
    """Return a table of the motions, and remarks on them."""
    columns = {
        "duration s": ("duration_s", 1.0, ".3f"),
        "bound s": ("bound_s", 1.0, ".3f"),
        "compute ms": ("compute_ms", 1.0, ".1f"),
        "velocity": ("max_velocity_ratio", 1.0, ".3f"),
        "acceleration": ("max_acceleration_ratio", 1.0, ".3f"),
        "off vertical mm": ("vertical_deviation_m", 1e3, ".2f"),
    }
    rows, remarks = [], []
    for index, motion in enumerate(summary["motions"]):
        cells = (_cell(motion[key], scale, style) for key, scale, style in columns.values())
        rows.append((str(index) if motion["found"] else f"{index} refused", *cells))
        if not motion["found"]:
            remarks.append(f"Motion {index}: {motion['reason']}.")
        for joint, excess in motion["range_excess"].items():
            remarks.append(f"Motion {index} leaves the nominal range of joint '{joint}' by {excess:.5f} (rad or m).")
    means = (_cell(summary[key], 1.0, ".3f") for key in ("mean_duration_s", "mean_bound_s"))
    title = f"Transfers by '{summary['planner']}' for {summary['arm']}, limits '{summary['limits']}'"
    remarks.append(
        "Velocity and acceleration: largest share of the limits, checked at 1 kHz and at all knots. "
        "Bound: no motion through the same waypoints is shorter."
    )
    if "out" in summary:
        remarks.append(f"saved {summary['out']}: the motions that were found, in order")
    return [rich_table(title, ("motion", *columns), [*rows, (), ("mean", *means, "", "", "", "")]), *remarks]


def _cell(value: float | None, scale: float, style: str) -> str:
    return "-" if value is None else format(scale * value, style)
