"""Readers of recorded sutures, one per file format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.suture.demonstrations.arrays import read_array
from trocar.tasks.suture.demonstrations.convention import Convention
from trocar.tasks.suture.demonstrations.jigsaws import read_jigsaws
from trocar.tasks.suture.demonstrations.lerobot import read_parquet
from trocar.tasks.suture.demonstrations.table import read_table

Reader = Callable[[Path, Convention, int | None], NDArray[np.float64] | SE3]
"""Takes a file, its convention and the episode; returns joint values (n, 6 arms) in the file's units, or poses
(n, arms) of the tips if the format has no joints."""

READERS: dict[str, Reader] = {
    ".npy": read_array,
    ".npz": read_array,
    ".csv": read_table,
    ".txt": read_jigsaws,
    ".parquet": read_parquet,
}
"""Readers by file extension."""


def read_recording(path: str | Path, convention: Convention, episode: int | None = None) -> NDArray[np.float64] | SE3:
    """Return the content of a file, read by the reader for its extension.

    Raises:
        TrocarError: the file is missing, empty or broken, or its extension or content is unknown.
    """
    path = Path(path)
    if path.suffix not in READERS:
        raise TrocarError(f"{str(path)!r} ends in {path.suffix!r}; recordings end in one of {', '.join(READERS)}")
    if not path.is_file():
        raise TrocarError(f"recording {str(path)!r} does not exist; correct its name in the manifest")
    if path.stat().st_size == 0:
        raise TrocarError(f"recording {str(path)!r} is empty; copy it again")
    if episode is not None and path.suffix != ".parquet":
        raise TrocarError(f"recording {str(path)!r} has no episodes, but episode {episode} was requested; leave it out")
    return READERS[path.suffix](path, convention, episode)
