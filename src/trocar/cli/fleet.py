"""``trocar calibrate prior`` and ``curve``: what instruments have in common, and what that saves."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from trocar.cli.out_folder import check_npz
from trocar.cli.progress import waiting
from trocar.cli.terminal import beside, results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import require_picture

if TYPE_CHECKING:
    from trocar.calibration.evaluation import Curve

PriorName = Annotated[
    str | None,
    typer.Option(
        metavar="fleet|none|FILE",
        help="What is known beforehand: 'fleet' is learned from six recordings of four instruments (default for play).",
    ),
]


def prior(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="Recordings of instruments, in any session.")
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="PRIOR", help="File to write (.npz).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Learn from recordings what instruments have in common, for fits on short ones.

    Leave out the recordings of an instrument on which you want to try the prior.
    """
    from trocar.calibration.fleet import learn_prior  # SciPy only when needed
    from trocar.calibration.fleet.prior import FORMAT
    from trocar.calibration.recording import load_recording

    check_npz(out, FORMAT, recordings)
    with waiting(f"learning from {counted(len(recordings), 'recording')}"):
        learned = learn_prior([load_recording(path) for path in recordings])
    learned.save(out)
    if as_json:
        sys.stdout.write(json.dumps({"sources": learned.sources, "out": str(out)}) + "\n")
        return
    results().print(f"learned from {', '.join(learned.sources)}; saved {out}")


def curve(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help=".npz, .csv or folder, as for `fit`.")],
    *,
    prior: PriorName = "fleet",
    rows: Annotated[str, typer.Option(metavar="N,N,...", help="Numbers of first rows; default: the usual ones.")] = "",
    plot: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw the curve.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print how well a play model predicts a recording, by how many of its rows it was fitted on."""
    from trocar.calibration.evaluation import curve as found_curve
    from trocar.calibration.evaluation import draw_curve
    from trocar.calibration.fleet import load_prior
    from trocar.calibration.recording import load_recording

    if plot is not None:
        require_picture(plot)
    if prior in (None, "none"):
        raise TrocarError("a curve compares fits with a prior and without; give --prior fleet or a file")
    known, data = load_prior(prior), load_recording(recording)
    with waiting(f"fitting on more and more rows of {data.name}"):
        found = found_curve(data, known, _numbers(rows))
    if as_json:
        values = {way: rmse.tolist() for way, rmse in found.rmse.items()}
        about = {"recording": found.recording, "rows": found.rows, "seconds": found.seconds, "tail": found.tail}
        sys.stdout.write(json.dumps(about | {"sources": known.sources, "rmse": values}) + "\n")
    else:
        _print(found, known.sources)
    if plot is not None:
        draw_curve(found, plot)
        (beside() if as_json else results()).print(f"picture: {plot}")


def _print(found: Curve, sources: Sequence[str]) -> None:
    table = Table(title=f"{found.recording}: RMSE of q4 q5 q6 on the last fifth ({counted(found.tail, 'row')}), rad")
    for column in ("rows", "time", *found.rmse):
        table.add_column(column, justify="right")
    for k, (count, seconds) in enumerate(zip(found.rows, found.seconds, strict=True)):
        cells = (" ".join(f"{value:.4f}" for value in rmse[k, 3:]) for rmse in found.rmse.values())
        table.add_row(str(count), f"{seconds:.0f} s", *cells)
    console = results()
    console.print(table)
    console.print(f"the prior was learned from {', '.join(sources)}")
    if found.recording in sources:
        console.print("this recording among them: the figures are no test of it; learn one without (`calibrate prior`)")


def _numbers(rows: str) -> list[int] | None:
    """Return the numbers in a list such as ``50,100``; None for none."""
    try:
        return [int(number) for number in rows.split(",")] if rows else None
    except ValueError:
        raise TrocarError(f"--rows {rows!r} is not a list of numbers; give one such as 50,100,200") from None
