"""``trocar study calibration``: Table I of the peg transfer's paper, and the errors of all cable models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from typer import Option

from trocar.cli.group import Result
from trocar.cli.options import Seed
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.cli.terminal import rich_table
from trocar.counting import counted
from trocar.files.output import PICTURE, make_folder, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from trocar.calibration.evaluation import Evaluation
    from trocar.calibration.study import SessionChange

KIND = "study of calibration"


def calibration(
    *,
    data: Annotated[
        Path, Option(envvar="TROCAR_DATA", help="Folder with dvrk/trajectories, or of the recordings (.npz, .csv).")
    ] = Path("../shared/data"),
    out: Annotated[Path | None, Option(metavar="DIR", help="Save summary.json and pictures here.")] = None,
    lstm: Annotated[bool, Option(help="Train the paper's network too (a minute or two).")] = True,
    seed: Seed = 0,
) -> Result:
    """Print Table I of the paper and the errors of all cable models, from recordings of real arms."""
    from trocar.calibration import study  # SciPy only when needed

    recordings = study.load_study_recordings(data, [*study.RECORDINGS, study.SESSION_RECORDING])
    pictures = {f"{name}_play.png": PICTURE for name in recordings}
    check_out_folder(out, {"summary.json": KIND, **pictures}, [data])
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
    shown = [
        errors_table(tables, study.TABLE_1),
        "The paper's column 'PSM2' is the recording psm1_grey_random, its 'PSM1' psm2_grey_random; its SD "
        "is that of |error|; its q3 maximum .0045 m is a misprint of .00045 m.",
        models_table(evaluations, study.LIMITS_RAD, study.REFERENCES_RAD),
    ]
    saved = [] if out is None else [f"saved summary.json and pictures in {out}"]
    return Result(summary, [_session_table(change), *saved], shown)


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
    from trocar.calibration.evaluation import draw_evaluation

    make_folder(out)
    for name, row in results.items():
        draw_evaluation(row["play"], out / f"{name}_play.png")
    write_json(out / "summary.json", summary, KIND)


def errors_table(tables: dict[str, dict[str, Any]], paper: dict[str, dict[str, tuple[float, ...]]]) -> Table:
    """Return Table I in mrad and mm, to fit into 80 columns."""
    lines: list[tuple[str, ...]] = []
    for name, rows in tables.items():
        for key, values in rows.items():
            shown = name.removesuffix("_random") if key == "RMSE" else ""
            lines.append((shown, key, "ours", *map(_thousandths, values)))
            lines.append(("", "", "paper", *map(_thousandths, paper[name][key])))
        lines.append(())
    head = ("recording", "", "", "q1", "q2", "q3", "q4", "q5", "q6")
    return rich_table("Table I: error of the uncorrected joints, mrad; q3 mm", head, lines)


def _thousandths(value: float) -> str:
    return f"{1e3 * value:.2g}" if abs(value) < 0.0995 else f"{1e3 * value:.0f}"


def models_table(
    results: dict[str, dict[str, Evaluation]],
    limits: dict[str, tuple[float, ...]],
    references: dict[str, dict[str, tuple[float, ...]]],
) -> Table:
    """Return the errors of the fitted models, beside the known errors of others."""
    lines: list[tuple[str, ...]] = []
    for name, row in results.items():
        first = next(iter(row.values()))
        lines.append((name.removesuffix("_random"), "none", _triple(first.rmse_before[3:]), "", ""))
        for model, result in row.items():
            bound = limits.get(name) if model == "play" else references.get(name, {}).get(model)
            beside = "" if bound is None else ("<= " if model == "play" else "") + _triple(np.array(bound))
            lines.append(("", model, _triple(result.rmse_after[3:]), beside, f"{result.compensation_ms:.2f} ms"))
        lines.append(())
    title = "Fitted on the first 80 %: RMSE q4 q5 q6 in rad on the last fifth"
    head = ("recording", "model", "ours", "reference, or limit", "time")
    return rich_table(title, head, lines, "time: of one compensation")


def _session_table(change: SessionChange) -> Table:
    title = "Another session (psm1_grey_pick_place) with play fitted on psm1_grey_random"
    lines = [
        ("uncorrected", _triple(change.uncorrected)),
        ("model of the other session", _triple(change.before)),
        (f"offsets refitted on {counted(change.refit_rows, 'row')}", _triple(change.after)),
    ]
    return rich_table(title, ("", "RMSE q4 q5 q6 in rad"), lines)


def _triple(values: Any) -> str:
    return " ".join(f"{value:.3f}" for value in values)
