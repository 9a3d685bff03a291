"""``trocar export``: saved trials as flat tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trocar.cli.progress import progress
from trocar.cli.terminal import beside
from trocar.errors import TrocarError

if TYPE_CHECKING:
    from trocar.eval.trial import Trial


def export(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run, or the file of one trial.")],
    *,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the tables.")],
    format: Annotated[
        str, typer.Option(metavar="csv|parquet", help="Format of the tables; parquet needs pyarrow.")
    ] = "csv",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Write saved trials as flat tables: trials, goals, spans, events, collisions, and what was sampled at 100 Hz.

    There is a row for each goal, span and so on of all trials, and in the folder 'samples' a table for each trial:
    joints as asked, commanded, measured and true, jaws, tips, bodies. 'columns' says what each column means.
    """
    from trocar.report.export import export_trials  # SciPy only when needed

    trials, strange = _chosen(run)
    for sentence in strange:
        beside().print(sentence, soft_wrap=True)
    with progress() as tick:
        written = export_trials(trials, out, format, lambda done, total: tick("writing tables", done=done, total=total))
    if as_json:
        tables = {
            str(table.path.relative_to(out)): {"rows": table.rows, "columns": list(table.columns)} for table in written
        }
        typer.echo(json.dumps({"out": str(out), "trials": len(trials), "left_aside": strange, "tables": tables}))
        return
    samples = [table for table in written if table.path.parent != out]
    for table in written:
        if table not in samples:
            typer.echo(f"{table.path}: {table.rows} rows of {len(table.columns)} columns")
    rows, columns = sum(table.rows for table in samples), len(samples[0].columns)
    typer.echo(f"{samples[0].path.parent}: {len(samples)} tables, {rows} rows of {columns} columns in all")


def _chosen(run: Path) -> tuple[Sequence[Trial], list[str]]:
    """Return the trials of a run's folder, or the one in a file, and a sentence for each that was left aside."""
    from trocar.eval.folder import load_trial, load_trials, still_to_do

    if run.suffix == ".npz" and not run.is_dir():
        return [load_trial(run)], []
    if run.is_file():
        raise TrocarError(f"{str(run)!r} is not a trial; give the folder of a run, or a file such as trial_000.npz")
    trials, strange = load_trials(run)
    return trials, [*strange, *still_to_do(run, len(trials))]
