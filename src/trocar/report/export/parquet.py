"""Flat tables as Parquet files."""

from __future__ import annotations

from pathlib import Path

from trocar.errors import InvalidInput
from trocar.extras import how_to_install
from trocar.files.output import MADE_BY, mark_of, writing
from trocar.report.export.table import FlatTable


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
