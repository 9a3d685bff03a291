"""``trocar study``: a paper's table, reproduced beside the paper's own figures."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.cli.terminal import details, results
from trocar.counting import counted
from trocar.errors import TrocarError
from trocar.files.output import PICTURE, make_folder, write_json

if TYPE_CHECKING:
    from trocar.calibration.evaluation import Evaluation
    from trocar.calibration.study import SessionChange

KIND = "study of calibration"


def calibration(
    *,
    data: Annotated[
        Path,
        typer.Option(envvar="TROCAR_DATA", help="Folder with dvrk/trajectories, or of the recordings (.npz, .csv)."),
    ] = Path("../shared/data"),
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Save summary.json and pictures here.")] = None,
    lstm: Annotated[bool, typer.Option(help="Train the paper's network too (a minute or two).")] = True,
    seed: Annotated[int, typer.Option(help="Seed of the training's randomness.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print Table I of the paper and the errors of all cable models, from recordings of real arms."""
    from trocar.calibration import study  # SciPy only when needed

    recordings = study.load_study_recordings(data, [*study.RECORDINGS, study.SESSION_RECORDING])
    pictures = {f"{name}_play.png": PICTURE for name in recordings}
    check_out_folder(out, {"summary.json": KIND, **pictures}, [data])
    if seed < 0:
        raise TrocarError(f"seed {seed} is negative; give 0 or more")
    names = ["offset", "ridge", *(["lstm"] if lstm else []), "play"]
    with progress() as tick:
        steps = iter(range(len(study.RECORDINGS) * len(names) + 1))

        def say(now: str) -> None:
            tick("cable models", next(steps), len(study.RECORDINGS) * len(names) + 1, now)

        tables = {name: study.table_1(recordings[name]) for name in study.TABLE_1}
        fitted = {name: recordings[name] for name in study.RECORDINGS}
        evaluations = study.run_models(fitted, names, seed, say)
        say("play after a change of session")
        model, _ = study.evaluate_model(recordings["psm1_grey_random"], "play", seed)
        change = study.session_change(model, recordings[study.SESSION_RECORDING])
    summary = _summary(tables, evaluations, change)
    if out is not None:
        _save(out, summary, evaluations)
    if as_json:
        sys.stdout.write(json.dumps(summary) + "\n")
        return
    printer = details()
    printer.print(errors_table(tables, study.TABLE_1))
    printer.print(
        "The paper's column 'PSM2' is the recording psm1_grey_random, its 'PSM1' psm2_grey_random; its SD "
        "is that of |error|; its q3 maximum .0045 m is a misprint of .00045 m."
    )
    printer.print(models_table(evaluations, study.LIMITS_RAD, study.REFERENCES_RAD))
    results().print(_session_table(change))
    if out is not None:
        results().print(f"saved summary.json and pictures in {out}")


def _summary(
    tables: dict[str, dict[str, Any]], results: dict[str, dict[str, Evaluation]], change: SessionChange
) -> dict[str, Any]:
    return {
        "study": "calibration",
        "table_1": {name: {key: row.tolist() for key, row in table.items()} for name, table in tables.items()},
        "models": {name: {model: result.summary() for model, result in row.items()} for name, row in results.items()},
        "session_change": {
            "model": "play",
            "refit_rows": change.refit_rows,
            "rows": change.rows,
            "rmse_uncorrected": change.uncorrected.tolist(),
            "rmse_before_refit": change.before.tolist(),
            "rmse_after_refit": change.after.tolist(),
        },
    }


def _save(out: Path, summary: dict[str, Any], results: dict[str, dict[str, Evaluation]]) -> None:
    from trocar.calibration.figure import draw_evaluation

    make_folder(out)
    for name, row in results.items():
        draw_evaluation(row["play"], out / f"{name}_play.png")
    write_json(out / "summary.json", summary, KIND)


def errors_table(tables: dict[str, dict[str, Any]], paper: dict[str, dict[str, tuple[float, ...]]]) -> Table:
    """Return Table I in mrad and mm, to fit into 80 columns."""
    table = Table(title="Table I: error of the uncorrected joints, mrad; q3 mm")
    for column in ("recording", "", "", "q1", "q2", "q3", "q4", "q5", "q6"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, rows in tables.items():
        for key, values in rows.items():
            shown = name.removesuffix("_random") if key == "RMSE" else ""
            table.add_row(shown, key, "ours", *map(_thousandths, values))
            table.add_row("", "", "paper", *map(_thousandths, paper[name][key]))
        table.add_section()
    return table


def _thousandths(value: float) -> str:
    return f"{1e3 * value:.2g}" if abs(value) < 0.0995 else f"{1e3 * value:.0f}"


def models_table(
    results: dict[str, dict[str, Evaluation]],
    limits: dict[str, tuple[float, ...]],
    references: dict[str, dict[str, tuple[float, ...]]],
) -> Table:
    """Return the errors of the fitted models, beside the known errors of others."""
    table = Table(
        title="Fitted on the first 80 %: RMSE q4 q5 q6 in rad on the last fifth",
        caption="time: of one compensation",
    )
    for column in ("recording", "model", "ours", "reference, or limit", "time"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, row in results.items():
        first = next(iter(row.values()))
        table.add_row(name.removesuffix("_random"), "none", _triple(first.rmse_before[3:]), "", "")
        for model, result in row.items():
            bound = limits.get(name) if model == "play" else references.get(name, {}).get(model)
            beside = "" if bound is None else ("<= " if model == "play" else "") + _triple(np.array(bound))
            cost = f"{result.compensation_ms:.2f} ms"
            table.add_row("", model, _triple(result.rmse_after[3:]), beside, cost)
        table.add_section()
    return table


def _session_table(change: SessionChange) -> Table:
    table = Table(title="Another session (psm1_grey_pick_place) with play fitted on psm1_grey_random")
    for column in ("", "RMSE q4 q5 q6 in rad"):
        table.add_column(column, justify="right")
    table.add_row("uncorrected", _triple(change.uncorrected))
    table.add_row("model of the other session", _triple(change.before))
    table.add_row(f"offsets refitted on {counted(change.refit_rows, 'row')}", _triple(change.after))
    return table


def _triple(values: Any) -> str:
    return " ".join(f"{value:.3f}" for value in values)
