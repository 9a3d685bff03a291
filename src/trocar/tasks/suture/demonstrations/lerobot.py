"""Joint states in the parquet files of LeRobot data sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.extras import how_to_install
from trocar.tasks.suture.demonstrations.arrays import pick_columns
from trocar.tasks.suture.demonstrations.convention import Convention

EPISODE = "episode_index"


def read_parquet(path: str | Path, convention: Convention, episode: int | None = None) -> NDArray[np.float64]:
    """Return the joint values (n, 6 arms) of one episode.

    The column named by ``convention.state`` holds one list of numbers per row; ``convention.columns`` numbers those
    that are joints, in the order of the arms (``meta/info.json`` of the data set says what they are).

    Raises:
        TrocarError: pyarrow is missing, the file is broken, or it has no such column or episode.
    """
    path = Path(path)
    table = _load(path)
    if convention.state not in table.column_names:
        raise TrocarError(
            f"{str(path)!r} has no column {convention.state!r}; it has {', '.join(table.column_names)}: "
            "name the state's column in the manifest"
        )
    rows = table.column(convention.state).to_pylist()
    if EPISODE in table.column_names:
        numbers = np.asarray(table.column(EPISODE).to_pylist())
        there = sorted(set(numbers.tolist()))
        if episode is None and len(there) > 1:
            raise TrocarError(
                f"{str(path)!r} holds {len(there)} episodes, {there[0]} to {there[-1]}; name the episode of "
                "each suture in the manifest"
            )
        if episode is not None and episode not in there:
            raise TrocarError(f"{str(path)!r} has no episode {episode}; it has {there[0]} to {there[-1]}")
        rows = [row for row, number in zip(rows, numbers, strict=True) if episode is None or number == episode]
    elif episode is not None:
        raise TrocarError(f"{str(path)!r} has no column {EPISODE!r} with which to find episode {episode}; leave it out")
    try:
        values = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        raise TrocarError(
            f"{str(path)!r}: the lists in {convention.state} differ in length or hold no numbers; name another column"
        ) from None
    if values.ndim != 2:
        raise TrocarError(f"{str(path)!r}: {convention.state} holds no lists of numbers; name a column that does")
    return pick_columns(values, convention, str(path))


def _load(path: Path) -> Any:
    """Return the table of a file."""
    try:
        import pyarrow as pa  # an extra, of 150 MB
        import pyarrow.parquet as pq
    except ImportError:
        raise TrocarError(f"reading {str(path)!r} needs pyarrow; {how_to_install('parquet')}") from None
    try:
        return pq.ParquetFile(path).read()
    except (OSError, pa.ArrowException):
        raise TrocarError(f"{str(path)!r} is not a readable parquet file; copy it again") from None
