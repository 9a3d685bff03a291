"""``trocar calibrate excite``: commands for a short recording of an arm."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from trocar.cli.terminal import results
from trocar.errors import TrocarError
from trocar.files.output import write_table

COLUMNS = ("q1_rad", "q2_rad", "q3_m", "q4_rad", "q5_rad", "q6_rad")


def excite(
    station: Annotated[str, typer.Argument(metavar="STATION", help="Name of a station, or a TOML file.")],
    *,
    arm: Annotated[str, typer.Option(metavar="ARM", help="Which arm.", show_default="the first")] = "",
    rows: Annotated[int, typer.Option(metavar="N", help="Samples; 75 take a minute.")] = 75,
    out: Annotated[Path, typer.Option(metavar="CSV", help="File to write.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write commands that reveal most about an arm's cables in the least time: wide swings.

    Go to each command in turn, let the arm come to rest, measure its joints; the first two rows take up the slack and
    need no measurement. Then: trocar calibrate fit RECORDING --prior fleet.
    """
    from trocar.calibration.excitation import slack_taken_up, wide_path  # SciPy only when needed
    from trocar.lab import load_station

    there = load_station(station)
    name = arm or next(iter(there.arms))
    box = there.arm(name).calibration
    if box is None:
        raise TrocarError(
            f"station {there.name!r} does not define where arm {name!r} moves during calibration; "
            f"add 'calibration' to [arms.{name}]"
        )
    if out.suffix != ".csv" or not out.parent.is_dir():
        raise TrocarError(f"file {str(out)!r} must end in .csv and lie in a folder that exists")
    model = there.arm(name).model
    q_cmd = slack_taken_up(model, wide_path(model, rows, box))
    write_table(out, COLUMNS, ([f"{value:.6f}" for value in row] for row in q_cmd))
    if as_json:
        sys.stdout.write(json.dumps({"arm": name, "q_cmd": q_cmd.tolist(), "out": str(out)}) + "\n")
        return
    results().print(
        f"{len(q_cmd)} commands for {name} ({model.name}), the first two without a measurement; saved {out}"
    )
