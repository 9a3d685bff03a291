"""A bundle adjustment: sphere positions, remote centre, wrist length and joints from all images together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trocar.arms import ArmModel, frames
from trocar.geometry import SE3, fit_rigid
from trocar.geometry.arrays import Array
from trocar.perception.fiducials import Fixture

CENTER_SD_M = 0.06e-3
"""SD of a centre found in an image, on each axis; prior knowledge is weighed against it."""
BASE_SD_M, WRIST_SD_M = 0.4e-3, 0.2e-3
"""SD of the remote centre found from encoders, on each axis (.36 mm in eight simulated sessions), and of the wrist's
length (assumed)."""
FAR_SDS = 3.0
"""A centre off by more SDs than this counts less (Huber): the sphere is partly hidden, or its rim misled the fit."""
MOST_STEPS, DONE = 20, 1e-7
"""Maximum number of Gauss-Newton steps, and the change, rad or m, at which they end."""

_WRIST_LINK, _SHAFT_AXIS = 5, 3  # frames: the wrist's link lies along x of frame 5, the shaft along z of frame 3


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The parameters that fit all centres best, without encoders."""

    arm: ArmModel  # with the wrist's length
    centers_m: Array  # (k, 3) of the spheres in the arm's frame 4 (shaft) or 6 (jaw)
    T_camera_base: SE3
    q: Array  # (n, 6) joints


def adjust(arm: ArmModel, fixture: Fixture, p_camera_m: Array, T_camera_base: SE3, q: Array) -> Adjusted:
    """Return sphere positions, remote centre, wrist length and joints that fit the centres best, by Gauss-Newton.

    The base keeps its rotation, which images cannot show: a rotation about the remote centre looks like other yaws,
    pitches and rolls. The only other unobservable direction is a rotation of the cross about the yaw axis, which looks
    like an offset of q6; the printer's tolerance, as a prior, decides there.

    Args:
        arm: a PSM.
        fixture: the spheres as designed, with their tolerance.
        p_camera_m: (n, k, 3) centres in the camera frame, NaN where a sphere was not seen; at least one of the shaft
            and three of the jaw in every row.
        T_camera_base: first estimate of the base.
        q: (n, 6) first estimate of the joints.
    """
    printed = fixture.frame_centers_m(arm)
    seen = np.all(np.isfinite(p_camera_m), axis=-1)
    p_base = T_camera_base.inverse().apply(np.nan_to_num(p_camera_m))
    rows, count = p_camera_m.shape[:2]
    # unknowns that all rows share: shifts of the base in its own axes (3) and of each sphere (3 k), wrist length (1)
    shared = np.zeros(3 * count + 4)
    known = np.concatenate([np.full(3, BASE_SD_M), np.full(3 * count, fixture.print_sd_m), [WRIST_SD_M]]) ** -2.0
    for _ in range(MOST_STEPS):
        shift, off, longer = shared[:3], shared[3:-1].reshape(count, 3), float(shared[-1])
        found = replace(arm, wrist_length_m=arm.wrist_length_m + longer)
        p, of_joints, of_shared = _model(found, fixture, printed + off, q)
        residual = np.where(seen[..., None], p + shift - p_base, 0.0)
        far = np.linalg.norm(residual, axis=-1) / (FAR_SDS * CENTER_SD_M)
        weight = (np.sqrt(1.0 / np.maximum(far, 1.0)) * seen / CENTER_SD_M)[..., None]
        r = (weight * residual).reshape(rows, 3 * count)
        J = (weight[..., None] * of_joints).reshape(rows, 3 * count, -1)
        G = (weight[..., None] * of_shared).reshape(rows, 3 * count, -1)
        # eliminate each row's joints (Schur complement), which leaves equations of the shared unknowns alone
        Jt = np.swapaxes(J, 1, 2)
        across = Jt @ G
        solved = np.linalg.solve(Jt @ J, np.concatenate([across, Jt @ r[..., None]], axis=-1))
        flat = G.reshape(-1, len(shared))
        normal = flat.T @ flat + np.diag(known) - np.einsum("nji,njk->ik", across, solved[..., :-1])
        slope = flat.T @ r.ravel() + known * shared - np.einsum("nji,nj->i", across, solved[..., -1])
        step = np.linalg.solve(normal, -slope)
        turn = -solved[..., -1] - solved[..., :-1] @ step
        shared, q = shared + step, q + turn
        if max(np.abs(step).max(), np.abs(turn).max()) < DONE:
            break
    T = T_camera_base @ SE3.from_parts(translation_m=shared[:3])
    found = replace(arm, wrist_length_m=arm.wrist_length_m + float(shared[-1]))
    return Adjusted(found, printed + shared[3:-1].reshape(count, 3), T, q)


def turned_to_encoders(arm: ArmModel, T_camera_base: SE3, q: Array, q_cmd: Array) -> SE3:
    """Return the base, rotated about its remote centre so that on average the shaft points as the encoders say.

    ``q`` (n, 6) are the joints in the base as given, ``q_cmd`` (n, 6) the encoder readings.
    """
    here, there = (frames(arm, joints).matrix[:, _SHAFT_AXIS, :3, 2] for joints in (q, q_cmd))
    both = (np.concatenate([axes, -axes]) for axes in (there, here))  # symmetric about zero, so that nothing shifts
    return T_camera_base @ SE3.from_parts(fit_rigid(*both).T_target_source.rotation)


def _model(arm: ArmModel, fixture: Fixture, centers_m: Array, q: Array) -> tuple[Array, Array, Array]:
    """Return centres (n, k, 3) in the base and their derivatives by the joints (n, k, 3, 6) and by shared unknowns."""
    poses, carriers = frames(arm, q).matrix, fixture.carriers(arm, q)
    R = carriers[..., :3, :3]
    p = (R @ centers_m[..., None])[..., 0] + carriers[..., :3, 3]
    rows, count = p.shape[:2]
    of_joints = np.zeros((rows, count, 3, len(arm.joints)))
    for i, joint in enumerate(arm.joints):
        axis, origin = poses[:, None, i + 1, :3, 2], poses[:, None, i + 1, :3, 3]
        of_joints[..., i] = axis if joint.prismatic else np.cross(axis, p - origin)
    of_joints[:, fixture.on_shaft, :, 4:] = 0.0
    of_shared = np.zeros((rows, count, 3, 3 * count + 4))
    of_shared[..., :3] = np.eye(3)
    for sphere in range(count):
        of_shared[:, sphere, :, 3 + 3 * sphere : 6 + 3 * sphere] = R[:, sphere]
    of_shared[..., -1] = ~fixture.on_shaft[:, None] * poses[:, None, _WRIST_LINK, :3, 0]
    return p, of_joints, of_shared
