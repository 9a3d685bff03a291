"""From the spheres' centres to the joints of a PSM, in closed form (Hwang et al. 2022, IV-A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, frames
from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.geometry.rigid_fit import fit_rigid
from trocar.perception.fiducials.fixture import Fixture

MIN_ON_JAW = 3


def require_psm(arm: ArmModel) -> None:
    """Raise TrocarError unless an arm's first axes are a PSM's, for which the closed form holds."""
    if not is_psm(arm):
        raise TrocarError(f"joints can be found from spheres on a PSM only, not on {arm.name!r}; give its recording")


def is_psm(arm: ArmModel) -> bool:
    """Return whether an arm's first axes are a PSM's: yaw and pitch through the remote centre, normal to each other."""
    half = np.pi / 2
    return bool(np.allclose(arm.twists_rad, (half, -half, half)) and np.allclose(arm.offsets[:2], (half, -half)))


def shaft_joints(arm: ArmModel, fixture: Fixture, p_base_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return q1 q2 q3 (n, 3) from centres (n, k, 3) of all spheres in the base; NaN if no shaft sphere was seen.

    The shaft runs through the remote centre, the base's origin, and its spheres sit on its axis: their direction gives
    yaw and pitch (farther spheres weigh more), their distance the insertion.
    """
    require_psm(arm)
    p = p_base_m[:, fixture.on_shaft]
    seen = np.all(np.isfinite(p), axis=-1)
    distance = np.where(seen, np.linalg.norm(p, axis=-1), 0.0)
    along = np.einsum("nk,nkx->nx", distance, np.where(seen[..., None], p, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        axis = along / np.linalg.norm(along, axis=1, keepdims=True)
        up = fixture.centers_m[fixture.on_shaft, 2]
        depth = (seen * (np.einsum("nx,nkx->nk", axis, np.nan_to_num(p)) + up)).sum(axis=1) / seen.sum(axis=1)
    x, y, z = axis.T
    return np.column_stack([np.arctan2(x, -z), np.arcsin(np.clip(-y, -1.0, 1.0)), depth - arm.offsets[2]])


def wrist_joints(
    arm: ArmModel, R_base_yaw: NDArray[np.float64], q_shaft: NDArray[np.float64], near: ArrayLike
) -> NDArray[np.float64]:
    """Return q4 q5 q6 (n, 3) from the rotation (n, 3, 3) of frame 6 and q1 q2 q3 (n, 3).

    ``near`` (n,) tells the turn of the roll. The branch is |q5| < 90 deg.
    """
    require_psm(arm)
    R_base_insertion = frames(arm, np.column_stack([q_shaft, np.zeros_like(q_shaft)])).matrix[:, 3, :3, :3]
    R = np.swapaxes(R_base_insertion, -1, -2) @ R_base_yaw
    jaw, axis = R[:, :, 1], -R[:, :, 2]  # the direction of the jaws, and the axis about which they turn
    w = arm.wrist_sign
    turn4 = np.arctan2(w * axis[:, 1], w * axis[:, 0])
    turn5 = np.arctan2(axis[:, 2], np.hypot(axis[:, 0], axis[:, 1]))
    c4, s4, c5, s5 = np.cos(turn4), np.sin(turn4), np.cos(turn5), np.sin(turn5)
    out = np.column_stack([s5 * c4, s5 * s4, -w * c5])
    side = np.column_stack([-s4, c4, np.zeros_like(c4)])
    turn6 = np.arctan2(-np.sum(side * jaw, axis=1), np.sum(out * jaw, axis=1))
    q = np.column_stack([turn4, turn5, turn6]) - np.array(arm.offsets[3:])
    q[:, 0] += TURN * np.round((np.asarray(near) - q[:, 0]) / TURN)
    return q


def jaw_rotations(arm: ArmModel, fixture: Fixture, p_base_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (n, 3, 3) of frame 6 in the base that fits the jaw's spheres; NaN with fewer than three."""
    jaw = ~fixture.on_shaft
    known = fixture.frame_centers_m(arm)[jaw]
    rotations = np.full((len(p_base_m), 3, 3), np.nan)
    for row, p in enumerate(p_base_m[:, jaw]):
        seen = np.isfinite(p).all(axis=1)
        if seen.sum() >= MIN_ON_JAW:
            rotations[row] = fit_rigid(known[seen], p[seen]).T_target_source.rotation.matrix
    return rotations


def joints_from_spheres(
    arm: ArmModel, fixture: Fixture, p_base_m: NDArray[np.float64], q_cmd: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joints (n, 6) of an arm whose spheres have these centres (n, k, 3) in its base.

    Args:
        arm: a PSM.
        fixture: that it wears.
        p_base_m: NaN where a sphere was not seen; joints that cannot be determined are NaN.
        q_cmd: (n, 6) commands; they only tell in which turn the roll is.
    """
    q_shaft = shaft_joints(arm, fixture, p_base_m)
    told = np.all(np.isfinite(q_shaft), axis=1)
    q = np.full((len(p_base_m), 6), np.nan)
    q[:, :3] = q_shaft
    R = jaw_rotations(arm, fixture, p_base_m)
    whole = told & np.all(np.isfinite(R), axis=(-1, -2))
    q[whole, 3:] = wrist_joints(arm, R[whole], q_shaft[whole], q_cmd[whole, 3])
    return q
