"""``trocar calibrate apply``: the commands that bring an arm's joints to where they should be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from trocar.calibration.recording import JOINT_NAMES
from trocar.cli.plugin import Plugins
from trocar.cli.terminal import results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import require_place, write_table

COLUMNS = ("t_s", *JOINT_NAMES)


def apply(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="File written by `trocar calibrate fit`.")],
    path: Annotated[
        Path,
        typer.Argument(metavar="PATH", help="CSV of where the joints should go; its first line names the columns."),
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="CSV", help=f"Commands to write: {','.join(COLUMNS)}.")],
    columns: Annotated[
        str, typer.Option(metavar="A,B,...", help="Names of the six joints' columns in PATH, in the arm's order.")
    ] = ",".join(JOINT_NAMES),
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Rows per second, if PATH has no column of times (t_s).")
    ] = None,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write the commands that move an arm's joints along a path, for your own controller; rad, and m for q3.

    The arm has to be at rest at the first row. A model with a window (lstm, ridge) gets rows as dense as those that it
    was fitted on, others keep yours.
    """
    from trocar.calibration.compensation import Compensator, sample_positions  # SciPy only when needed
    from trocar.calibration.models import load_model
    from trocar.motion.analysis import read_joint_table

    del plugin  # loaded when it was parsed
    names = columns.split(",")
    if len(set(names)) != len(JOINT_NAMES):
        raise TrocarError(f"--columns {columns!r} names {len(set(names))} different columns; an arm has six joints")
    if rate is not None and not 0 < rate < np.inf:
        raise TrocarError(f"--rate {rate} is not a rate; give a number above 0, in Hz")
    if out.suffix != ".csv":
        raise TrocarError(f"file {str(out)!r} must end in .csv; choose another name")
    require_place(out, "table of commands", [model, path], mark=",".join(COLUMNS))
    fitted, table = load_model(model), read_joint_table(path, rate)
    wanted = table.columns(names, path)
    if not np.isfinite(wanted).all():
        row = int(np.flatnonzero(~np.isfinite(wanted).all(axis=1))[0])
        raise TrocarError(f"row {row + 2} of {str(path)!r} has no number for every joint; fill it in, or cut it out")
    compensator, rows = Compensator(fitted), np.arange(len(wanted))
    at = rows if compensator.method == "exact" else sample_positions(wanted, fitted.training)
    desired = np.column_stack([np.interp(at, rows, column) for column in wanted.T])
    commands = compensator.path(desired)
    if not np.isfinite(commands).all():
        raise TrocarError(f"model {str(model)!r} gives commands that are not finite for this path; fit it again")
    lines = np.column_stack([at * table.step_s, commands])
    write_table(out, COLUMNS, ([f"{value:.9g}" for value in line] for line in lines))
    largest = np.abs(commands - desired).max(axis=0)
    if as_json:
        said = {"rows": len(lines), "largest_correction": largest.tolist(), "out": str(out)}
        typer.echo(json.dumps({"model": fitted.name, **said}))
        return
    degrees = " ".join(f"{value:.1f}" for value in np.degrees(largest[3:]))
    results().print(
        f"{counted(len(lines), 'command')} by {fitted.name}; largest corrections of q4 q5 q6: {degrees} deg; "
        f"saved {out}",
        soft_wrap=True,
    )
