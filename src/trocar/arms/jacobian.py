"""Jacobian and manipulability, and the distance from joint limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms.forward import frames
from trocar.arms.model import ArmModel


def jacobian(arm: ArmModel, q: ArrayLike) -> NDArray[np.float64]:
    """Return the geometric Jacobian(s) (..., 6, 6), from joint velocities to the tip's velocity in the base frame.

    Rows are the tip's linear velocity (m/s), then its angular velocity (rad/s). For the PSM exactly
    ``|det J| = cos q2 * d * (d cos q5 + L3)`` with d = q3 - .0156 (``facts/peg_transfer.md``, Kinematics).

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    poses = frames(arm, q).matrix
    tip = poses[..., 7, :3, 3]
    J = np.zeros((*poses.shape[:-3], 6, 6))
    for i, joint in enumerate(arm.joints):
        axis = poses[..., i + 1, :3, 2]
        if joint.prismatic:
            J[..., :3, i] = axis
        else:
            J[..., :3, i] = np.cross(axis, tip - poses[..., i + 1, :3, 3])
            J[..., 3:, i] = axis
    return J


def manipulability(arm: ArmModel, q: ArrayLike) -> NDArray[np.float64]:
    """Return Yoshikawa's measure ``|det J|`` (...,) in m^2; it is zero where the tip loses a degree of freedom.

    The unit follows from three rows in m/s and three in rad/s, five columns per rad/s and one (the insertion) per m/s:
    m^3 rad^3 / (rad^5 m), with rad = 1.

    Yaw, pitch and roll are pure rotations about the remote centre, so the determinant factorises::

        |det J| = |sin(twist1) sin(twist2) sin t2| * |d (d cos t5 + L3)|

    with t2, t5 the pitch angles with their offsets and d the depth of the wrist beyond the remote centre. For the PSM
    this is the formula in ``facts/peg_transfer.md``.

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    q = arm.configurations(q)
    (_, s1), (_, s2) = arm.twist_cosines[1:]
    depth = wrist_depth_m(arm, q)
    arm_part = s1 * s2 * np.sin(q[..., 1] + arm.offsets[1])
    wrist_part = depth * (depth * np.cos(q[..., 4] + arm.offsets[4]) + arm.wrist_length_m)
    return np.abs(arm_part * wrist_part)


def wrist_depth_m(arm: ArmModel, q: ArrayLike) -> NDArray[np.float64]:
    """Return the depth (...,) in m of the wrist's pitch axis beyond the remote centre; compare ``safe_depth_m``."""
    return -arm.wrist_sign * (np.asarray(q, dtype=np.float64)[..., 2] + arm.offsets[2])


def joint_margins(arm: ArmModel, q: ArrayLike) -> NDArray[np.float64]:
    """Return the distance of every joint from its nearer limit (..., 6), rad and m; negative outside.

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    q = arm.configurations(q)
    return np.minimum(q - arm.lower, arm.upper - q)


def limit_violations(arm: ArmModel, q: ArrayLike) -> list[str]:
    """Return one sentence for each joint that leaves its range, at its worst over the configuration(s).

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    q = arm.configurations(q)
    worst = np.atleast_2d(q).reshape(-1, 6)
    worst = worst[np.argmin(np.minimum(worst - arm.lower, arm.upper - worst), axis=0), range(6)]
    return [
        f"joint '{joint.name}' = {value:.4f} {joint.unit} is outside [{joint.lower:.4f}, {joint.upper:.4f}] "
        f"{joint.unit} by {max(joint.lower - value, value - joint.upper):.4f}"
        for joint, value in zip(arm.joints, worst.tolist(), strict=True)
        if not joint.lower <= value <= joint.upper
    ]
