"""``trocar analyse``: velocity, acceleration and jerk of a recorded motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from typer import Argument, Option

from trocar.cli.group import Result
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import waiting
from trocar.cli.terminal import rich_table
from trocar.counting import counted
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.files.output import PICTURE, make_folder, write_json, write_table

if TYPE_CHECKING:
    from trocar.arms import ArmModel
    from trocar.motion.analysis import Derivatives

JOINTS = ("q1", "q2", "q3", "q4", "q5", "q6")
TIP = ("x", "y", "z")

KIND = "analysis of a motion"
FILES = {"motion.png": PICTURE, "summary.json": KIND}
"""The files that are written beside motion.csv, with their kinds."""


def analyse(
    recording: Annotated[
        Path,
        Argument(
            metavar="FILE",
            help="CSV of measured joints, its first line naming the columns, or a trial's .npz of a run.",
        ),
    ],
    *,
    arm: Annotated[
        str,
        Option(
            help="CSV: model of the arm, for its tip (psm-classic). Trial: which arm (default: the one that worked)."
        ),
    ] = "",
    columns: Annotated[
        str, Option(metavar="A,B,...", help="CSV: columns to analyse; default: q1 to q6 (rad, m), or all.")
    ] = "",
    rate: Annotated[
        float | None, Option(metavar="HZ", help="CSV without a column of times (t_s, in s): samples per second.")
    ] = None,
    smoothness: Annotated[
        float | None, Option(help="Weight of smoothness.", show_default="by cross-validation, for each joint")
    ] = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Write motion.csv, motion.png and summary.json here.")
    ] = None,
) -> Result:
    """Estimate velocity, acceleration and jerk of joints and tool tip from measured positions (Huber losses)."""
    from trocar.motion.analysis import analyse as estimate  # SciPy only when needed
    from trocar.motion.analysis import analyse_joints

    check_out_folder(out, FILES, [recording])
    if out is not None and recording.resolve() == (out / "motion.csv").resolve():
        raise InvalidInput(f"--out {str(out)!r}", "would replace the recording that is read", "give another folder")
    for name, value in (("--rate", rate), ("--smoothness", smoothness)):
        if value is not None and not 0 < value < np.inf:
            raise InvalidValue(name, value, "give a number above 0")
    names, measured, step_s, model = _measured(recording, arm, columns, rate)
    parts: dict[str, tuple[tuple[str, ...], Derivatives]] = {}
    with waiting(f"estimating the motion of {counted(len(names), 'signal')}, {counted(len(measured), 'sample')}"):
        if model is None:
            parts["joints"] = (names, estimate(measured, step_s, smoothness))
        else:
            found = analyse_joints(model, measured, step_s, smoothness)
            parts = {"joints": (names, found.joints), "tip": (TIP, found.tip)}
    summary = _summary(recording, parts, model)
    lines = _lines(summary, parts)
    if out is not None:
        _save(out, parts, summary)
        lines.append("files: " + ", ".join(str(out / name) for name in ("motion.csv", *FILES)))
    return Result(summary, lines)


def _measured(
    path: Path, arm: str, columns: str, rate: float | None
) -> tuple[tuple[str, ...], np.ndarray, float, ArmModel | None]:
    """Return names, positions (n, k), the step in s and, for the six joints of an arm, its model."""
    from trocar.arms import ARMS, PSM_CLASSIC
    from trocar.motion.joint_table import read_joint_table

    if path.suffix == ".npz":
        for option, given in (("--columns", columns), ("--rate", rate)):
            if given:
                raise InvalidInput(option, "has no effect on a trial, whose joints are known", f"drop {option}")
        return _of_trial(path, arm)
    model = ARMS.pick(arm) if arm else PSM_CLASSIC
    table = read_joint_table(path, rate)
    wanted = [name.strip() for name in columns.split(",") if name.strip()]
    usual = not wanted and all(name in table.names for name in JOINTS)
    chosen = wanted or (list(JOINTS) if usual else list(table.names))
    if arm and len(chosen) != len(JOINTS):
        problem = f"needs six joints, and {len(chosen)} columns would be analysed"
        raise InvalidInput(f"--arm {arm}", problem, "name the joints in order with --columns, or drop --arm")
    of_arm = usual or (bool(arm) and len(chosen) == len(JOINTS))
    return tuple(chosen), table.columns(chosen, path), table.step_s, model if of_arm else None


def _of_trial(path: Path, arm: str) -> tuple[tuple[str, ...], np.ndarray, float, ArmModel]:
    from trocar.eval.trial import Trial

    trial = Trial.load(path)
    name = arm or trial.arms[0]
    if name not in trial.scenery.arms:
        raise UnknownName(f"arm of trial {str(path)!r}", name, trial.arms)
    measured = trial.arrays[f"measured_{name}"][:, :6].astype(np.float64)
    return JOINTS, measured, trial.scenery.tick_s, trial.scenery.arms[name]


def _summary(
    path: Path, parts: Mapping[str, tuple[tuple[str, ...], Derivatives]], model: ArmModel | None
) -> dict[str, Any]:
    first = next(iter(parts.values()))[1]
    summary: dict[str, Any] = {
        "file": str(path),
        "samples": len(first.position),
        "step_s": first.step_s,
        "arm": None if model is None else model.name,
    }
    for part, (names, found) in parts.items():
        rms, largest = found.rms(), found.largest()
        summary[part] = {
            name: {kind: {"rms": float(rms[kind][k]), "max": float(largest[kind][k])} for kind in rms}
            for k, name in enumerate(names)
        }
    if "tip" in parts:
        position = parts["tip"][1].position
        summary["path_m"] = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    return summary


def _lines(summary: Mapping[str, Any], parts: Mapping[str, Any]) -> list[Any]:
    rows = [
        (f"tip {name}" if part == "tip" else name, *(f"{k['rms']:.4g} / {k['max']:.4g}" for k in kinds.values()))
        for part in parts
        for name, kinds in summary[part].items()
    ]
    title = f"{counted(summary['samples'], 'sample')}, {summary['samples'] * summary['step_s']:.1f} s"
    columns = ("signal", "velocity /s", "acceleration /s^2", "jerk /s^3")
    lines: list[Any] = [rich_table(title, columns, rows, "RMS / largest, in the signal's unit and seconds")]
    return lines + ([f"path of the tip: {summary['path_m']:.3f} m"] if "path_m" in summary else [])


def _save(out: Path, parts: Mapping[str, tuple[tuple[str, ...], Derivatives]], summary: Mapping[str, Any]) -> None:
    from trocar.report.plot import draw_motion  # matplotlib only when needed

    make_folder(out)
    header, columns = ["t_s"], [summary["step_s"] * np.arange(summary["samples"])]
    for part, (names, found) in parts.items():
        jerk = np.vstack([found.jerk, found.jerk[-1:]])  # jerk is between samples: repeat the last
        for k, name in enumerate(names):
            label = f"tip_{name}" if part == "tip" else name
            header += [label, f"{label}_velocity", f"{label}_acceleration", f"{label}_jerk"]
            columns += [found.position[:, k], found.velocity[:, k], found.acceleration[:, k], jerk[:, k]]
    rows = ([f"{value:.9g}" for value in row] for row in np.column_stack(columns))
    write_table(out / "motion.csv", header, rows)
    write_json(out / "summary.json", summary, KIND)
    draw_motion(parts, out / "motion.png")
