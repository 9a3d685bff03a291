"""Point clouds from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trocar.errors import BadFile, UnknownName
from trocar.files.reading import read_arrays
from trocar.geometry.arrays import Array

UNITS_M = {"mm": 1e-3, "m": 1.0}


def load_capture(path: str | Path, unit: str | None = None) -> Array:
    """Return the points (n, 3) in m of an .npz (``points_mm``, ``points_m``, or its only array) or .npy file.

    Args:
        path: the file.
        unit: 'mm' or 'm'; required if the array's name does not tell it.

    Raises:
        UnknownName: there is no such unit.
        BadFile: the file is missing, broken or of another shape, or its unit is unknown or contradictory.
    """
    if unit is not None and unit not in UNITS_M:
        raise UnknownName("unit", unit, UNITS_M)

    def bad(problem: str, remedy: str) -> BadFile:
        return BadFile(path, problem, remedy, kind="capture")

    if not Path(path).is_file():
        problem = "is a folder" if Path(path).is_dir() else "does not exist"
        raise bad(problem, "give an .npz or .npy file of points (n, 3)")
    try:
        arrays = read_arrays(path)
    except (OSError, ValueError):
        raise bad("cannot be read as .npz or .npy of numbers", "save the points again") from None
    named = next((name for name in ("points_mm", "points_m") if name in arrays), None)
    if named is None and len(arrays) != 1:
        raise bad(f"holds {', '.join(arrays) or 'nothing'}", "it needs an array points_mm or points_m")
    known = named and named.removeprefix("points_")
    if known is None and unit is None:
        raise bad("does not tell its unit", "add --unit mm or --unit m")
    if known and unit and known != unit:
        raise bad(f"holds {named}, but --unit says {unit!r}", "leave --unit out")
    points = arrays[named] if named else next(iter(arrays.values()))
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise bad(f"holds {points.dtype} of shape {points.shape}", "it needs numbers of shape (n, 3)")
    return points.astype(np.float64) * UNITS_M[unit or known or "m"]
