"""Writes the tables of trials into a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.files.output import make_folder
from trocar.report.export.notes import Notes
from trocar.report.export.parquet import require_parquet, write_parquet
from trocar.report.export.samples import samples_of
from trocar.report.export.table import Column, FlatTable

FORMATS: dict[str, Callable[[FlatTable, Path], Path]] = {"csv": FlatTable.write_csv, "parquet": write_parquet}
COLUMNS = (
    Column("table", "name of the table"),
    Column("column", "name of the column"),
    Column("unit", "of its numbers"),
    Column("about", "what it means"),
)


@dataclass(frozen=True)
class Written:
    """One table that was written.

    Attributes:
        path: of the file.
        rows: their number.
        columns: their names.
    """

    path: Path
    rows: int
    columns: tuple[str, ...]


def export_trials(
    trials: Sequence[Trial],
    folder: str | Path,
    format: str = "csv",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Written]:
    """Write trials of one run as flat tables, and return what was written.

    ``trials``, ``goals``, ``spans``, ``events`` and ``collisions`` have the rows of all trials; what was sampled at 100
    Hz is in ``samples``, one table per trial; ``columns`` says what each column means.

    Args:
        trials: each is read once.
        folder: made if it is not there.
        format: a key of :data:`FORMATS`.
        progress: called with the number of trials done and of all.

    Raises:
        TrocarError: the format is unknown or needs what is not installed, or a file is in the way.
        MachineError: a file cannot be written.
    """
    if format not in FORMATS:
        raise InvalidInput(f"format {format!r}", "is unknown", f"choose one of {', '.join(FORMATS)}")
    if format == "parquet":
        require_parquet()
    folder, notes, told = make_folder(folder), Notes(), {}
    sampled = make_folder(folder / "samples")

    def write(table: FlatTable, path: Path) -> Written:
        told.update({(table.name, column.name): column for column in table.columns})
        FORMATS[format](table, path)
        return Written(path, len(table), tuple(column.name for column in table.columns))

    samples = []
    for number, trial in enumerate(trials):
        progress(number, len(trials))
        notes.add(trial)
        name = f"session_{trial.about['session']:02d}_trial_{trial.about['index']:03d}"
        samples.append(write(samples_of(trial), sampled / f"{name}.{format}"))
    noted = [write(table, folder / f"{table.name}.{format}") for table in notes.tables()]
    rows = [(table, column.name, column.unit, column.about) for (table, _), column in told.items()]
    columns = write(FlatTable.of_rows("columns", COLUMNS, rows), folder / f"columns.{format}")
    return [*noted, *samples, columns]
