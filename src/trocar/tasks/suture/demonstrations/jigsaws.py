"""Text files of JIGSAWS recordings (76 columns, 30 Hz, no header): Cartesian poses, no joints."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, shown
from trocar.tasks.suture.demonstrations.convention import LENGTHS, SLIDE, Convention

COLUMNS = 76
SLAVES = (38, 57)
"""First column of the left slave, then of the right: position m (3), rotation row by row (9), velocity (3), angular
velocity (3, unreliable), gripper (1); the masters come before (``facts/suture.md``)."""

NAMES = ("left", "right")

MIN_SPREAD_M = 0.3e-3
"""A suture's poses spread over more than this; metres read as mm spread over less."""

SKEWED = 0.2
"""A matrix that differs by more than this from the nearest rotation, in the largest entry, is not a rotation."""


def read_jigsaws(path: str | Path, convention: Convention, episode: int | None = None) -> SE3:
    """Return the poses (n, 2) of the slaves' tips, left and right, in the frame of the recording.

    Recorded rotations are rounded; each is replaced by the nearest rotation.

    Raises:
        TrocarError: the file is not such a text, its lengths are in another unit than the manifest says, or the
            manifest does not have two arms.
    """
    if len(convention.arms) != len(SLAVES):
        raise TrocarError(
            f"{str(path)!r} records two slaves, left and right, but the manifest has {len(convention.arms)} arm(s); "
            "name two"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is reported below
            values = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError, UnicodeDecodeError):
        raise TrocarError(
            f"{str(path)!r} is not a readable text of {COLUMNS} numbers per row, as JIGSAWS writes it; copy it again"
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
    places_m = used[..., :3] * LENGTHS[convention.lengths]
    _check_spread(places_m, convention, path)
    return SE3.from_parts(rotations, places_m)


def _check_spread(places_m: NDArray[np.float64], convention: Convention, path: str | Path) -> None:
    """Raise if positions (n, 2, 3) of the tips exceed an arm's reach, or spread so little that mm must be m."""
    spread_m = np.linalg.norm(np.ptp(places_m, axis=0), axis=-1)
    reach_m = 2 * np.array([arm.upper[SLIDE] + arm.tip_length_m for arm in convention.arms])
    far = int(np.argmax(spread_m - reach_m))
    if spread_m[far] > reach_m[far]:
        unit = 'set lengths = "mm" in its manifest' if convention.lengths == "m" else "correct them"
        raise TrocarError(
            f"{str(path)!r}: the poses of the {NAMES[far]} slave spread over {spread_m[far]:.3g} m, more than the "
            f"{reach_m[far]:.2g} m that {convention.arms[far].name} reaches; {unit}"
        )
    if convention.lengths == "mm" and spread_m.max() < MIN_SPREAD_M:
        raise TrocarError(
            f"{str(path)!r}: the poses spread over {shown(spread_m.max(), 'm', '.2g')} only, too little for a suture: "
            'they seem to be in m; set lengths = "m" in its manifest'
        )


def nearest_rotations(matrices: NDArray[np.float64]) -> tuple[SO3, NDArray[np.float64]]:
    """Return the rotations nearest to matrices (..., 3, 3), and how far (...,) their largest entry moved."""
    U, _, Vt = np.linalg.svd(matrices)
    sign = np.ones((*matrices.shape[:-2], 1, 3))
    sign[..., 0, 2] = np.linalg.det(U @ Vt)
    R = (U * sign) @ Vt
    return SO3(R), np.abs(R - matrices).max((-1, -2))
