"""Joint states in NumPy files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.files.reading import read_arrays
from trocar.tasks.suture.demonstrations.convention import Convention

NAMES = ("q", "joints")


def read_array(path: str | Path, convention: Convention, episode: int | None = None) -> NDArray[np.float64]:
    """Return the joint values (n, 6 arms) of a .npy file, or of ``q``, ``joints`` or the only array of an .npz file.

    Raises:
        TrocarError: the file is broken or has another shape.
    """
    values = _load(path)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise TrocarError(f"{str(path)!r} has shape {values.shape} of {values.dtype}; it needs numbers (n, joints)")
    return pick_columns(values.astype(np.float64), convention, str(path))


def pick_columns(values: NDArray[np.float64], convention: Convention, where: str) -> NDArray[np.float64]:
    """Return the joints' columns (n, 6 arms) out of unnamed columns (n, m), as the convention numbers them."""
    columns, arms, have = convention.columns, len(convention.arms), values.shape[1]
    if columns is None:
        if have != convention.width:
            raise TrocarError(
                f"{where!r} has {have} columns; {arms} arm(s) need {convention.width}, six joints each: correct the "
                "arms in the manifest, or number the joints' columns there"
            )
        return values
    numbers = [column for column in columns if isinstance(column, int)]
    if len(numbers) != len(columns):
        raise TrocarError(f"the columns of {where!r} have no names; number them from 0 in the manifest")
    if not all(0 <= number < have for number in numbers):
        wrong = next(number for number in numbers if not 0 <= number < have)
        raise TrocarError(f"{where!r} has columns 0 to {have - 1}, not {wrong}; correct the columns of the manifest")
    return values[:, numbers]


def _load(path: str | Path) -> NDArray:
    try:
        arrays = read_arrays(path)
    except (OSError, ValueError):
        raise TrocarError(f"{str(path)!r} is not a readable .npy or .npz of numbers; save it again") from None
    name = next((name for name in NAMES if name in arrays), None)
    if name is None and len(arrays) != 1:
        raise TrocarError(f"{str(path)!r} holds {', '.join(arrays) or 'nothing'}; name the joint states 'q'")
    return arrays[name or next(iter(arrays))]
