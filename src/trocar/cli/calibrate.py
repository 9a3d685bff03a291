"""``trocar calibrate``: recordings and cable models: fit, evaluate, apply, and what short recordings need."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from trocar.calibration.recording import JOINT_NAMES
from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName
from trocar.cli.out_folder import require_file
from trocar.cli.progress import waiting
from trocar.cli.terminal import rich_table
from trocar.counting import counted
from trocar.errors import InvalidInput
from trocar.files.output import require_picture, write_table

RecordingPath = Annotated[
    Path,
    Argument(
        metavar="RECORDING",
        help=".npz with q_cmd, q_phy (optional: valid, t_s); .csv with q1_commanded_rad to q6_measured_rad (q3 in m; "
        "optional: time_s, valid); or a folder of q_cmd.npy, q_phy.npy (or q_des.npy, q_act.npy)",
    ),
]
ModelPath = Annotated[Path, Argument(metavar="MODEL", help="File written by `trocar calibrate fit`.")]
PriorName = Annotated[
    str | None,
    Option(
        metavar="fleet|none|FILE",
        help="What is known beforehand: 'fleet' is learned from six recordings of four instruments (default for play).",
    ),
]
Plot = Annotated[Path | None, Option(metavar="PNG", help="Draw a picture.")]

COMMANDS = ("t_s", *JOINT_NAMES)
"""Columns of a table of commands."""


def fit(
    recording: RecordingPath,
    *,
    out: Annotated[Path, Option(metavar="MODEL", help="Model file to write (.npz).")],
    model: Annotated[str, Option(help="offset, ridge, play, lstm (extra 'learn'), or your own.")] = "play",
    rows: Annotated[int | None, Option(metavar="N", help="Fit on the first N rows only.")] = None,
    fraction: Annotated[float | None, Option(help="Fit on this first share of the rows only.")] = None,
    prior: PriorName = None,
    seed: Seed = 0,
) -> Result:
    """Fit a cable model to a recording; with a prior, a minute of it is enough."""
    from trocar.calibration.fleet import fit_from_prior, load_prior  # SciPy only when needed
    from trocar.calibration.models import FORMAT, MODELS, save_model
    from trocar.calibration.recording import load_recording

    kind = MODELS.pick(model)
    require_file("--out", out, FORMAT, (".npz",), [recording])
    data = load_recording(recording)
    data = data.first(_first_rows(len(data), rows, fraction))
    data.require_motion()
    prior = prior or ("fleet" if model == "play" else "none")
    if prior != "none" and model != "play":
        raise InvalidInput(f"cable model {model!r}", "starts from no prior", "leave --prior out, or fit 'play'")
    good = counted(int(data.valid.sum()), "row")
    with waiting(f"fitting {model} on {good} of {data.name}"):
        rng = np.random.default_rng(seed)
        fitted = kind.fit(data, rng) if prior == "none" else fit_from_prior(data, load_prior(prior))
    save_model(fitted, out)
    error = (fitted.predict(data.q_cmd) - data.q_phy)[data.valid]
    rmse = np.sqrt(np.mean(error**2, axis=0))
    summary = {"model": model, "prior": prior, "out": str(out), "rows": int(data.valid.sum())}
    told = f"fitted {model} on {good}: RMSE q4 q5 q6 {' '.join(f'{value:.4f}' for value in rmse[3:])} rad; saved {out}"
    return Result(summary | {"rmse_fit": rmse.tolist()}, [told])


def _first_rows(total: int, rows: int | None, fraction: float | None) -> int:
    """Return how many of the first rows to fit on."""
    if rows is not None and fraction is not None:
        raise InvalidInput("--rows and --fraction", "are both given", "give one of them")
    if fraction is not None:
        if not 0.0 < fraction <= 1.0:
            raise InvalidInput(f"--fraction {fraction}", "is outside (0, 1]", "give a share such as 0.8")
        return int(fraction * total)
    return total if rows is None else rows


def evaluate(
    model: ModelPath,
    recording: RecordingPath,
    *,
    from_row: Annotated[int, Option(metavar="K", help="Errors count from this row on.")] = 0,
    refit: Annotated[
        int, Option(metavar="N", min=0, help="Refit the offsets on N valid rows first, as in a new session; 0: do not.")
    ] = 0,
    plot: Plot = None,
) -> Result:
    """Measure the errors of a model on a recording, from row K on.

    Its memory runs over all rows, whatever K is. The picture shows joints and hysteresis loops.
    """
    from trocar.calibration.evaluation import draw_evaluation, refit_ends, refit_offset
    from trocar.calibration.evaluation import evaluate as score
    from trocar.calibration.models import load_model
    from trocar.calibration.recording import load_recording

    if plot is not None:
        require_picture(plot)
    fitted, data = load_model(model), load_recording(recording)
    if refit:
        fitted = refit_offset(fitted, data, refit)
        from_row = max(from_row, refit_ends(data, refit))
    result = score(fitted, data, from_row)
    shown = []
    for name, before, after in zip(JOINT_NAMES, result.rmse_before, result.rmse_after, strict=True):
        unit, digits = ("m", 5) if name == "q3" else ("rad", 4)
        shown.append((name, f"{before:.{digits}f} {unit}", f"{after:.{digits}f} {unit}"))
    title = f"{result.model} on {data.name}, {counted(result.rows, 'row')} from row {from_row}"
    lines = [
        rich_table(title, ("joint", "RMSE uncorrected", "RMSE predicted"), shown),
        f"one compensation takes {result.compensation_ms:.2f} ms",
    ]
    if plot is not None:
        draw_evaluation(result, plot)
        lines.append(f"picture: {plot}")
    return Result(result.summary(), lines)


def apply(
    model: ModelPath,
    path: Annotated[
        Path, Argument(metavar="PATH", help="CSV of where the joints should go; its first line names the columns.")
    ],
    *,
    out: Annotated[Path, Option(metavar="CSV", help=f"Commands to write: {','.join(COMMANDS)}.")],
    columns: Annotated[
        str, Option(metavar="A,B,...", help="Names of the six joints' columns in PATH, in the arm's order.")
    ] = ",".join(JOINT_NAMES),
    rate: Annotated[
        float | None, Option(metavar="HZ", help="Rows per second, if PATH has no column of times (t_s).")
    ] = None,
) -> Result:
    """Write the commands that move an arm's joints along a path, for your own controller; rad, and m for q3.

    The arm has to be at rest at the first row. A model with a window (lstm, ridge) gets rows as dense as those that it
    was fitted on, others keep yours.
    """
    from trocar.calibration.compensation import Compensator, sample_positions  # SciPy only when needed
    from trocar.calibration.models import load_model
    from trocar.motion.joint_table import read_joint_table

    names = columns.split(",")
    if len(set(names)) != len(JOINT_NAMES):
        problem = f"names {len(set(names))} different columns"
        raise InvalidInput(f"--columns {columns!r}", problem, "an arm has six joints")
    if rate is not None and not 0 < rate < np.inf:
        raise InvalidInput(f"--rate {rate}", "is not a rate", "give a number above 0, in Hz")
    require_file("--out", out, "table of commands", (".csv",), [model, path], mark=",".join(COMMANDS))
    fitted, table = load_model(model), read_joint_table(path, rate)
    wanted = table.columns(names, path)
    if not np.isfinite(wanted).all():
        row = int(np.flatnonzero(~np.isfinite(wanted).all(axis=1))[0])
        where = f"row {row + 2} of {str(path)!r}"
        raise InvalidInput(where, "has no number for every joint", "fill it in, or cut it out")
    compensator, rows = Compensator(fitted), np.arange(len(wanted))
    at = rows if fitted.rate_independent else sample_positions(wanted, fitted.training)
    desired = np.column_stack([np.interp(at, rows, column) for column in wanted.T])
    commands = compensator.path(desired)
    if not np.isfinite(commands).all():
        raise InvalidInput(f"model {str(model)!r}", "gives commands that are not finite for this path", "fit it again")
    lines = np.column_stack([at * table.step_s, commands])
    write_table(out, COMMANDS, ([f"{value:.9g}" for value in line] for line in lines))
    largest = np.abs(commands - desired).max(axis=0)
    degrees = " ".join(f"{value:.1f}" for value in np.degrees(largest[3:]))
    summary = {"model": fitted.name, "rows": len(lines), "largest_correction": largest.tolist(), "out": str(out)}
    told = f"{counted(len(lines), 'command')} by {fitted.name}; largest corrections of q4 q5 q6: {degrees} deg"
    return Result(summary, [f"{told}; saved {out}"])


def excite(
    station: StationName,
    *,
    arm: Annotated[str, Option(metavar="ARM", help="Which arm.", show_default="the first")] = "",
    rows: Annotated[int, Option(metavar="N", help="Samples; 75 take a minute.")] = 75,
    out: Annotated[Path, Option(metavar="CSV", help="File to write.")],
) -> Result:
    """Write commands that reveal most about an arm's cables in the least time: wide swings.

    Go to each command in turn, let the arm come to rest, measure its joints; the first two rows take up the slack and
    need no measurement. Then: trocar calibrate fit RECORDING --prior fleet.
    """
    from trocar.calibration.excitation import slack_taken_up, wide_path  # SciPy only when needed
    from trocar.lab import load_station

    there = load_station(station)
    name = arm or next(iter(there.arms))
    header = ("q1_rad", "q2_rad", "q3_m", "q4_rad", "q5_rad", "q6_rad")
    require_file("--out", out, "table of commands", (".csv",), mark=",".join(header))
    model, box = there.arm(name).model, there.calibration_box(name)
    q_cmd = slack_taken_up(model, wide_path(model, rows, box))
    write_table(out, header, ([f"{value:.6f}" for value in row] for row in q_cmd))
    told = f"{len(q_cmd)} commands for {name} ({model.name}), the first two without a measurement; saved {out}"
    return Result({"arm": name, "q_cmd": q_cmd.tolist(), "out": str(out)}, [told])


def prior(
    recordings: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="Recordings of instruments, in any session.")
    ],
    *,
    out: Annotated[Path, Option(metavar="PRIOR", help="File to write (.npz).")],
) -> Result:
    """Learn from recordings what instruments have in common, for fits on short ones.

    Leave out the recordings of an instrument on which you want to try the prior.
    """
    from trocar.calibration.fleet import learn_prior  # SciPy only when needed
    from trocar.calibration.fleet.prior import FORMAT
    from trocar.calibration.recording import load_recording

    require_file("--out", out, FORMAT, (".npz",), recordings)
    with waiting(f"learning from {counted(len(recordings), 'recording')}"):
        learned = learn_prior([load_recording(path) for path in recordings])
    learned.save(out)
    told = f"learned from {', '.join(learned.sources)}; saved {out}"
    return Result({"sources": learned.sources, "out": str(out)}, [told])
