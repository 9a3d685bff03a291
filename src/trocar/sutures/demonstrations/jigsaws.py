"""The 76-column text of the JIGSAWS recordings (30 Hz, no header): Cartesian poses, no joints."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.sutures.demonstrations.convention import Convention

COLUMNS = 76
SLAVES = (38, 57)
"""First column of the slave left, then right: position m (3), rotation row by row (9), velocity (3), angular velocity
(3, unreliable), gripper (1); the masters come before (``facts/suture.md``)."""

SKEWED = 0.2
"""A matrix farther than this from the nearest rotation, in the largest entry, is none."""


def read_jigsaws(path: Path, convention: Convention, episode: int | None = None) -> SE3:
    """Return the poses (n, 2) of the slaves' tips, left and right, in the frame of the recording.

    Printed rotations are rounded; each is replaced by the nearest rotation.

    Raises:
        TrocarError: the file is no such text, or the manifest has not two arms.
    """
    if len(convention.arms) != len(SLAVES):
        raise TrocarError(
            f"{str(path)!r} records two slaves, left and right, but the manifest has {len(convention.arms)} arm(s); "
            "name two"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is told of below
            values = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError, UnicodeDecodeError):
        raise TrocarError(
            f"{str(path)!r} is not a readable text of {COLUMNS} numbers a row, as JIGSAWS writes it; copy it again"
        ) from None
    if values.shape[1] != COLUMNS:
        raise TrocarError(f"{str(path)!r} has {values.shape[1]} columns; a JIGSAWS recording has {COLUMNS}")
    if len(values) < 2:
        raise TrocarError(f"{str(path)!r} has {len(values)} row(s); a recorded suture needs 2 or more")
    used = np.stack([values[:, start : start + 12] for start in SLAVES], 1)
    bad = np.flatnonzero(~np.isfinite(used).all((1, 2)))
    if len(bad):
        raise TrocarError(f"{str(path)!r}: row {bad[0]} holds NaN or infinity for a slave's pose; leave the row out")
    rotations, off = nearest_rotations(used[..., 3:].reshape(*used.shape[:2], 3, 3))
    if off.max() > SKEWED:
        row = int(np.argmax(off.max(1)))
        raise TrocarError(
            f"{str(path)!r}: the rotation of row {row} is {off.max():.2g} away from any rotation; the columns are not "
            "those of JIGSAWS"
        )
    return SE3.from_parts(rotations, used[..., :3])


def nearest_rotations(matrices: NDArray[np.float64]) -> tuple[SO3, NDArray[np.float64]]:
    """Return the rotations nearest to matrices (..., 3, 3), and how far (...,) their largest entry moved."""
    U, _, Vt = np.linalg.svd(matrices)
    sign = np.ones((*matrices.shape[:-2], 1, 3))
    sign[..., 0, 2] = np.linalg.det(U @ Vt)
    R = (U * sign) @ Vt
    return SO3(R), np.abs(R - matrices).max((-1, -2))
