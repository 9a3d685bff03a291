"""Point clouds from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.files.reading import read_arrays

UNITS_M = {"mm": 1e-3, "m": 1.0}


def load_capture(path: str | Path, unit: str | None = None) -> NDArray[np.float64]:
    """Return the points (n, 3) in m of an .npz (``points_mm``, ``points_m``, or its only array) or .npy file.

    Args:
        path: the file.
        unit: 'mm' or 'm'; required if the array's name does not tell it.

    Raises:
        TrocarError: the file is missing, broken or of another shape, or its unit is unknown or contradictory.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS_M:
        raise TrocarError(f"unit {unit!r} is not one of {', '.join(UNITS_M)}")
    if path.is_dir():
        raise TrocarError(f"{str(path)!r} is a folder; give an .npz or .npy file of points (n, 3)")
    if not path.is_file():
        raise TrocarError(f"capture {str(path)!r} does not exist; give an .npz or .npy file of points (n, 3)")
    try:
        arrays = read_arrays(path)
    except (OSError, ValueError):
        raise TrocarError(
            f"capture {str(path)!r} cannot be read as .npz or .npy of numbers; save the points again"
        ) from None
    named = [name for name in ("points_mm", "points_m") if name in arrays]
    if not named and len(arrays) != 1:
        choices = ", ".join(arrays) or "nothing"
        raise TrocarError(f"capture {str(path)!r} needs an array points_mm or points_m, it holds {choices}")
    name = named[0] if named else next(iter(arrays))
    known = name.removeprefix("points_") if named else None
    if known is None and unit is None:
        raise TrocarError(f"the unit of capture {str(path)!r} is unknown; add --unit mm or --unit m")
    if known and unit and known != unit:
        raise TrocarError(f"capture {str(path)!r} holds {name}, but --unit says {unit!r}; leave --unit out")
    points = arrays[name]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise TrocarError(
            f"capture {str(path)!r} needs numbers of shape (n, 3), got {points.dtype} of shape {points.shape}"
        )
    return points.astype(np.float64) * UNITS_M[unit or known or "m"]
