"""``trocar calibrate``: fit cable models on recordings and evaluate them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from trocar.cli.fleet import PriorName
from trocar.cli.out_folder import check_npz
from trocar.cli.plugin import Plugins
from trocar.cli.progress import waiting
from trocar.cli.terminal import results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import require_picture

RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help=".npz with q_cmd, q_phy (optional: valid, t_s); .csv with q1_commanded_rad to q6_measured_rad (q3 in m; "
        "optional: time_s, valid); or a folder of q_cmd.npy, q_phy.npy (or q_des.npy, q_act.npy)",
    ),
]


def fit(
    recording: RecordingPath,
    *,
    out: Annotated[Path, typer.Option(metavar="MODEL", help="Model file to write (.npz).")],
    model: Annotated[str, typer.Option(help="offset, ridge, play, lstm (extra 'learn'), or your own.")] = "play",
    rows: Annotated[int | None, typer.Option(metavar="N", help="Fit on the first N rows only.")] = None,
    fraction: Annotated[float | None, typer.Option(help="Fit on this first share of the rows only.")] = None,
    prior: PriorName = None,
    seed: Annotated[int, typer.Option(help="Seed of the training's randomness.")] = 0,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Fit a cable model to a recording; with a prior, a minute of it is enough."""
    from trocar.calibration.fleet import fit_from_prior, load_prior  # SciPy only when needed
    from trocar.calibration.models import MODELS, save_model
    from trocar.calibration.models.files import FORMAT
    from trocar.calibration.recording import load_recording, require_motion

    del plugin  # loaded when it was parsed
    kind = MODELS.pick(model)
    if seed < 0:
        raise TrocarError(f"seed {seed} is negative; give 0 or more")
    check_npz(out, FORMAT, [recording])
    data = load_recording(recording)
    data = data.first(_rows(len(data), rows, fraction))
    require_motion(data)
    prior = prior or ("fleet" if model == "play" else "none")
    if prior != "none" and model != "play":
        raise TrocarError(f"cable model {model!r} starts from no prior; leave --prior out, or fit 'play'")
    good = counted(int(data.valid.sum()), "row")
    with waiting(f"fitting {model} on {good} of {data.name}"):
        rng = np.random.default_rng(seed)
        fitted = kind.fit(data, rng) if prior == "none" else fit_from_prior(data, load_prior(prior))
    save_model(fitted, out)
    error = (fitted.predict(data.q_cmd) - data.q_phy)[data.valid]
    rmse = np.sqrt(np.mean(error**2, axis=0))
    if as_json:
        summary = {
            "model": model,
            "prior": prior,
            "out": str(out),
            "rows": int(data.valid.sum()),
            "rmse_fit": rmse.tolist(),
        }
        sys.stdout.write(json.dumps(summary) + "\n")
        return
    wrist = " ".join(f"{value:.4f}" for value in rmse[3:])
    results().print(f"fitted {model} on {good}: RMSE q4 q5 q6 {wrist} rad; saved {out}")


def evaluate(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="File written by `trocar calibrate fit`.")],
    recording: RecordingPath,
    *,
    from_row: Annotated[int, typer.Option(metavar="K", help="Errors count from this row on.")] = 0,
    refit: Annotated[
        int,
        typer.Option(metavar="N", help="Refit the offsets on N valid rows first, as in a new session; 0: do not."),
    ] = 0,
    plugin: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    plot: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw joints and hysteresis loops.")] = None,
) -> None:
    """Measure the errors of a model on a recording, from row K on.

    Its memory runs over all rows, whatever K is.
    """
    from trocar.calibration.evaluation import evaluate as score
    from trocar.calibration.fitting import refit_ends, refit_offset
    from trocar.calibration.models import load_model
    from trocar.calibration.recording import load_recording

    del plugin  # loaded when it was parsed
    if plot is not None:
        require_picture(plot)
    fitted, data = load_model(model), load_recording(recording)
    if refit < 0:
        raise TrocarError(f"a refit on {refit} rows is impossible; give 0 or more")
    if refit:
        fitted = refit_offset(fitted, data, refit)
        from_row = max(from_row, refit_ends(data, refit))
    result = score(fitted, data, from_row)
    if plot is not None:
        from trocar.calibration.figure import draw_evaluation

        draw_evaluation(result, plot)
    if as_json:
        sys.stdout.write(json.dumps(result.summary()) + "\n")
        return
    table = Table(title=f"{result.model} on {data.name}, {counted(result.rows, 'row')} from row {from_row}")
    for column in ("joint", "RMSE uncorrected", "RMSE predicted"):
        table.add_column(column, justify="right")
    summary = result.summary()
    for name, before, after in zip(
        summary["joints"],  # type: ignore[arg-type]
        result.rmse_before,
        result.rmse_after,
        strict=True,
    ):
        unit, digits = ("m", 5) if name == "q3" else ("rad", 4)
        table.add_row(name, f"{before:.{digits}f} {unit}", f"{after:.{digits}f} {unit}")
    console = results()
    console.print(table)
    console.print(f"one compensation takes {result.compensation_ms:.2f} ms")
    if plot is not None:
        console.print(f"picture: {plot}")


def _rows(total: int, rows: int | None, fraction: float | None) -> int:
    """Return how many of the first rows to fit on."""
    if rows is not None and fraction is not None:
        raise TrocarError("--rows and --fraction are both given; give one of them")
    if fraction is not None:
        if not 0.0 < fraction <= 1.0:
            raise TrocarError(f"--fraction {fraction} is outside (0, 1]; give a share such as 0.8")
        return int(fraction * total)
    return total if rows is None else rows
