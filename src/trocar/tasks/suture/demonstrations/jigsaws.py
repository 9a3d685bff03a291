"""Text files of JIGSAWS recordings (76 columns, 30 Hz, no header): Cartesian poses, from which joints are solved."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik_unbounded
from trocar.errors import BadFile
from trocar.geometry import SE3, SO3, shown
from trocar.tasks.suture.demonstrations.manifest import Manifest
from trocar.tasks.suture.demonstrations.recordings import INSERTION, UNITS

COLUMNS = 76
SLAVES = (38, 57)
"""First column of the left slave, then of the right: position m (3), rotation row by row (9), velocity (3), angular
velocity (3, unreliable), gripper (1); the masters come before (``facts/suture.md``)."""

MIN_SPREAD_M = 0.3e-3
"""A suture's poses spread over more than this; metres read as mm spread over less."""

SKEWED = 0.2
"""A matrix that differs by more than this from the nearest rotation, in the largest entry, is not a rotation."""

MIN_REAL_SHARE = 0.5
"""Share of a recording's poses for which the arm must have a solution; with fewer the bases are wrong."""


def read_jigsaws(path: Path, rows: slice, manifest: Manifest) -> SE3:
    """Return rows of the poses (n, 2) of the slaves' tips, left and right, in the frame of the recording.

    Recorded rotations are rounded; each is replaced by the nearest rotation.

    Raises:
        BadFile: the file is not such a text, its lengths are in another unit than the manifest says, or the manifest
            does not have two arms.
    """
    if len(manifest.arms) != len(SLAVES):
        raise BadFile(
            path, f"records two slaves, but the manifest has {len(manifest.arms)} arm(s)", "name two, left and right"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is reported below
            values = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError, UnicodeDecodeError):
        raise BadFile(
            path, f"is not a text of {COLUMNS} numbers per row, as JIGSAWS writes it", "copy it again"
        ) from None
    if values.shape[1] != COLUMNS or len(values) < 2:
        raise BadFile(path, f"has {values.shape[0]} row(s) of {values.shape[1]} columns", f"it needs 2 of {COLUMNS}")
    used = np.stack([values[:, start : start + 12] for start in SLAVES], 1)
    bad = np.flatnonzero(~np.isfinite(used).all((1, 2)))
    if len(bad):
        raise BadFile(path, f"holds NaN or infinity for a slave's pose in row {bad[0]}", "leave the row out")
    rotations, off = nearest_rotations(used[..., 3:].reshape(*used.shape[:2], 3, 3))
    if off.max() > SKEWED:
        row = int(np.argmax(off.max(1)))
        raise BadFile(path, f"has a rotation in row {row} that is {off.max():.2g} away from any: not JIGSAWS' columns")
    places_m = used[..., :3] * manifest.length_m
    spread_m = np.linalg.norm(np.ptp(places_m, axis=0), axis=-1)
    reach_m = 2 * np.array([arm.upper[INSERTION] + arm.tip_length_m for arm in manifest.models])
    if (spread_m > reach_m).any() or spread_m.max() < MIN_SPREAD_M:
        found = f"has poses whose positions spread over {' and '.join(shown(each, 'm', '.3g') for each in spread_m)}"
        raise BadFile(
            path, f"{found}; a suture takes {shown(MIN_SPREAD_M, 'm')} to {shown(reach_m.min(), 'm')}", f"check {UNITS}"
        )
    return SE3.from_parts(rotations, places_m)[rows]


def nearest_rotations(matrices: NDArray[np.float64]) -> tuple[SO3, NDArray[np.float64]]:
    """Return the rotations nearest to matrices (..., 3, 3), and how far (...,) their largest entry moved."""
    U, _, Vt = np.linalg.svd(matrices)
    sign = np.ones((*matrices.shape[:-2], 1, 3))
    sign[..., 0, 2] = np.linalg.det(U @ Vt)
    R = (U * sign) @ Vt
    return SO3(R), np.abs(R - matrices).max((-1, -2))


def joints_from_poses(
    recordings: Sequence[tuple[Path, SE3]], manifest: Manifest
) -> tuple[list[NDArray[np.float64]], str]:
    """Return joints (n, arms, 6) of recorded poses (n, arms), and what was assumed, in words.

    Poses without a solution are left out.

    Args:
        recordings: file and poses as recorded of all sutures of a set, which share the bases.
        manifest: the recorded arms, and the poses of their bases if known.

    Raises:
        BadFile: most poses of a recording cannot be reached from the bases.
    """
    arms = manifest.models
    turn = SE3.from_parts(SO3.from_quaternion(manifest.recorded_tip_wxyz))
    tips = [(path, recording @ turn) for path, recording in recordings]
    bases = manifest.T_frame_base or assumed_bases([tip for _, tip in tips], arms)
    lower, upper = (np.stack([getattr(arm, end) for arm in arms]) for end in ("lower", "upper"))
    joints, outside, lost, total = [], 0, 0, 0
    for path, tip in tips:
        q = np.stack([ik_unbounded(arm, bases[a].inverse() @ tip[:, a]) for a, arm in enumerate(arms)], 1)
        real = np.asarray(np.isfinite(q).all((1, 2)))
        if real.mean() < MIN_REAL_SHARE or real.sum() < 2:
            raise BadFile(
                path,
                f"has poses of which {100 * (1 - real.mean()):.0f} % cannot be reached from the arms' bases",
                "correct the bases, or the frame of the recorded tip, in the manifest",
            )
        outside += int(((q[real] < lower) | (q[real] > upper)).any((1, 2)).sum())
        lost, total = lost + int((~real).sum()), total + real.size
        joints.append(q[real])
    given = (
        "bases as given in the manifest"
        if manifest.bases
        else "assumed bases, from which each arm's mean recorded pose is that at the middle of its joints' ranges"
    )
    return joints, (
        f"joints by inverse kinematics from Cartesian poses, {given}; {100 * outside / total:.0f} % of the poses then "
        f"lie outside the joints' limits, {100 * lost / total:.0f} % have no solution"
    )


def assumed_bases(tips: list[SE3], arms: Sequence[ArmModel]) -> tuple[SE3, ...]:
    """Return a plausible base for each arm: one from which it works in the middle of its joints' ranges.

    Poses of the tip do not determine the remote centre (the inverse kinematics has solutions for any), so it is assumed
    such that the mean pose of the tip over all recordings (n, arms) is that at the middle of the joints' ranges.
    """
    bases = []
    for a, arm in enumerate(arms):
        matrices = np.concatenate([tip.matrix[:, a] for tip in tips])
        rotation, _ = nearest_rotations(matrices[:, :3, :3].mean(0))
        mean = SE3.from_parts(rotation, matrices[:, :3, 3].mean(0))
        bases.append(mean @ fk(arm, arm.middle).inverse())
    return tuple(bases)
