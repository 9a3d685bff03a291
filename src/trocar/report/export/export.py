"""Tables of trials for other programs, in CSV or Parquet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.extras import how_to_install
from trocar.files.output import MADE_BY, make_folder, mark_of, writing
from trocar.report.export.table import Column, FlatTable, Notes, samples_of


def require_parquet() -> None:
    """Raise TrocarError if Parquet files cannot be written here; check this before anything is read."""
    try:
        import pyarrow  # noqa: F401 - an extra, of 150 MB
    except ImportError:
        raise InvalidInput("--format parquet", "needs pyarrow", f"{how_to_install('parquet')}, or use csv") from None


def write_parquet(table: FlatTable, path: str | Path) -> Path:
    """Write a table as Parquet, its mark in the file's metadata, and return the path; raises as ``writing`` does."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {"text": pa.string(), "integer": pa.int64(), "number": pa.float64(), "truth": pa.bool_()}
    arrays = [pa.array(v, types[column.kind]) for column, v in zip(table.columns, table.values, strict=True)]
    filled = pa.Table.from_arrays(arrays, names=[column.name for column in table.columns])
    path, kind = Path(path), f"table of {table.name}"
    with writing(path, kind) as draft, pq.ParquetWriter(draft, filled.schema, store_schema=False) as file:
        file.write_table(filled)
        file.add_key_value_metadata({MADE_BY: mark_of(kind)})  # at the very end of the file, where it is searched for
    return path


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
