"""Joints from recorded poses, for recordings without joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik_unbounded
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.suture.demonstrations.convention import Convention
from trocar.tasks.suture.demonstrations.jigsaws import nearest_rotations

MIN_REAL_SHARE = 0.5
"""Share of a recording's poses for which the arm must have a solution; with fewer the bases are wrong."""


def joints_from_poses(
    recordings: Sequence[SE3], convention: Convention, where: Sequence[str]
) -> tuple[list[NDArray[np.float64]], str]:
    """Return joints (n, arms, 6) of recorded poses (n, arms), and what was assumed, in words.

    Poses without a solution are left out.

    Args:
        recordings: poses as recorded, of all sutures of a set, which share the bases.
        convention: the recorded arms, and the poses of their bases if known.
        where: names of the files, for error sentences.

    Raises:
        TrocarError: most poses of a recording cannot be reached from the bases.
    """
    turn = SE3.from_parts(convention.R_recorded_tip)
    tips = [recording @ turn for recording in recordings]
    bases = convention.T_frame_base or assumed_bases(tips, convention)
    joints, outside, lost, total = [], 0, 0, 0
    for tip, name in zip(tips, where, strict=True):
        q = np.stack([ik_unbounded(arm, bases[a].inverse() @ tip[:, a]) for a, arm in enumerate(convention.arms)], 1)
        real = np.asarray(np.isfinite(q).all((1, 2)))
        if real.mean() < MIN_REAL_SHARE or real.sum() < 2:
            raise TrocarError(
                f"{name}: {100 * (1 - real.mean()):.0f} % of the poses cannot be reached from the arms' bases; "
                "correct the bases, or the frame of the recorded tip, in the manifest"
            )
        lower, upper = (np.stack([getattr(arm, end) for arm in convention.arms]) for end in ("lower", "upper"))
        outside += int(((q[real] < lower) | (q[real] > upper)).any((1, 2)).sum())
        lost, total = lost + int((~real).sum()), total + real.size
        joints.append(q[real])
    given = (
        "bases as given in the manifest"
        if convention.T_frame_base
        else "assumed bases, from which each arm's mean recorded pose is that at the middle of its joints' ranges"
    )
    return joints, (
        f"joints by inverse kinematics from Cartesian poses, {given}; {100 * outside / total:.0f} % of the poses then "
        f"lie outside the joints' limits, {100 * lost / total:.0f} % have no solution"
    )


def assumed_bases(tips: Sequence[SE3], convention: Convention) -> tuple[SE3, ...]:
    """Return a plausible base for each arm: one from which it works in the middle of its joints' ranges.

    Poses of the tip do not determine the remote centre (the inverse kinematics has solutions for any), so it is assumed
    such that the mean pose of the tip over all recordings (n, arms) is that at the middle of the joints' ranges.
    """
    bases = []
    for a, arm in enumerate(convention.arms):
        matrices = np.concatenate([tip.matrix[:, a] for tip in tips])
        rotation, _ = nearest_rotations(matrices[:, :3, :3].mean(0))
        mean = SE3.from_parts(rotation, matrices[:, :3, 3].mean(0))
        bases.append(mean @ fk(arm, arm.middle).inverse())
    return tuple(bases)
