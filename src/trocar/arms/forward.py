"""Forward kinematics: poses, Jacobian, manipulability, and violations of the joints' ranges."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms.model import ArmModel
from trocar.checks import outside, small
from trocar.geometry import SE3
from trocar.geometry.arrays import Array


def fk(arm: ArmModel, q: ArrayLike) -> SE3:
    """Return ``T_base_tip`` of configurations ``q`` (..., 6), rad and m.

    Raises:
        TrocarError: ``q`` has another shape or is not finite.

    Example:
        >>> from trocar.arms import PSM_CLASSIC, fk
        >>> T_base_tip = fk(PSM_CLASSIC, [0.1, 0.2, 0.15, 0.5, 0.3, -0.2])
        >>> (1e3 * T_base_tip.translation_m).round(1).tolist()
        [10.6, -34.0, -147.9]
    """
    q = arm.configurations(q)
    if q.ndim == 1:
        return SE3.unchecked(np.array(_tip(arm, q.tolist(), cos, sin)).reshape(4, 4))
    matrix = np.empty((*q.shape[:-1], 16))
    for i, entry in enumerate(_tip(arm, np.moveaxis(q, -1, 0), np.cos, np.sin)):
        matrix[..., i] = entry
    return SE3.unchecked(matrix.reshape(*q.shape[:-1], 4, 4))


def frames(arm: ArmModel, q: ArrayLike) -> SE3:
    """Return the poses, in the base, of frames 0 (base), 1..6 (modified DH) and 7 (tip): batch (..., 8)."""
    steps = _steps(arm, arm.configurations(q))
    poses = [np.broadcast_to(np.eye(4), steps.shape[:-3] + (4, 4))]
    for i in range(len(arm.joints)):
        poses.append(poses[-1] @ steps[..., i, :, :])
    tip = np.array([[-1.0, 0, 0, 0], [0, 0, -1, arm.tip_length_m], [0, -1, 0, 0], [0, 0, 0, 1]])
    return SE3.unchecked(np.stack([*poses, poses[-1] @ tip], -3))


def jacobian(arm: ArmModel, q: ArrayLike) -> Array:
    """Return the geometric Jacobian(s) (..., 6, 6), from joint velocities to the tip's velocity in the base frame.

    Rows are the tip's linear velocity (m/s), then its angular velocity (rad/s). For the PSM exactly
    ``|det J| = cos q2 * d * (d cos q5 + L3)`` with d = q3 - .0156.

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


def manipulability(arm: ArmModel, q: ArrayLike) -> Array:
    """Return Yoshikawa's measure ``|det J|`` (...,) in m^2; it is zero where the tip loses a degree of freedom.

    Yaw, pitch and roll are pure rotations about the remote centre, so the determinant factorises into
    ``|sin(twist1) sin(twist2) sin t2| * |d (d cos t5 + L3)|``, with t2, t5 the pitch angles with their offsets and d
    the depth of the wrist beyond the remote centre.

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    q = arm.configurations(q)
    (_, s1), (_, s2) = arm.twist_cosines[1:]
    depth = wrist_depth_m(arm, q)
    arm_part = s1 * s2 * np.sin(q[..., 1] + arm.offsets[1])
    wrist_part = depth * (depth * np.cos(q[..., 4] + arm.offsets[4]) + arm.wrist_length_m)
    return np.abs(arm_part * wrist_part)


def wrist_depth_m(arm: ArmModel, q: ArrayLike) -> Array:
    """Return the depth (...,) in m of the wrist's pitch axis beyond the remote centre; compare ``safe_depth_m``."""
    return -arm.wrist_sign * (np.asarray(q, dtype=np.float64)[..., 2] + arm.offsets[2])


def limit_violations(arm: ArmModel, q: ArrayLike) -> list[str]:
    """Return one sentence for each joint that leaves its range, at its worst over the configuration(s).

    Raises:
        TrocarError: ``q`` has another shape or is not finite.
    """
    q = arm.configurations(q)
    worst = np.atleast_2d(q).reshape(-1, 6)
    worst = worst[np.argmin(np.minimum(worst - arm.lower, arm.upper - worst), axis=0), range(6)]
    found = []
    for joint, value in zip(arm.joints, worst.tolist(), strict=True):
        excess = max(joint.lower - value, value - joint.upper)
        if excess > 0.0:
            shown, ends = outside(value, joint.lower, joint.upper)
            out = f"is outside {ends} {joint.unit} by {small(excess)}"
            found.append(f"joint '{joint.name}' = {shown} {joint.unit} {out}")
    return found


def _steps(arm: ArmModel, q: Array) -> Array:
    """Return the pose of each frame in the one before it (..., 6, 4, 4): modified DH, all joints at once."""
    wrist = arm.wrist_sign * pi / 2
    slides = np.array([joint.prismatic for joint in arm.joints])
    alpha = np.array((*arm.twists_rad, 0.0, wrist, wrist))
    value = q + np.array(arm.offsets)
    theta = np.where(slides, 0.0, value - np.array([0, 0, 0, 0, pi / 2, pi / 2]))
    d = np.where(slides, value, 0.0)
    (ca, sa), (ct, st) = (np.cos(alpha), np.sin(alpha)), (np.cos(theta), np.sin(theta))
    steps = np.zeros((*q.shape, 4, 4))
    steps[..., 0, 0], steps[..., 0, 1] = ct, -st
    steps[..., 1, 0], steps[..., 1, 1], steps[..., 1, 2], steps[..., 1, 3] = ca * st, ca * ct, -sa, -sa * d
    steps[..., 2, 0], steps[..., 2, 1], steps[..., 2, 2], steps[..., 2, 3] = sa * st, sa * ct, ca, ca * d
    steps[..., 5, 0, 3] = arm.wrist_length_m
    steps[..., 3, 3] = 1.0
    return steps


def _tip(arm: ArmModel, q: Any, cos: Callable[[Any], Any], sin: Callable[[Any], Any]) -> tuple[Any, ...]:
    """Return the 16 entries of ``T_base_tip``, row by row; ``q`` is six floats or six arrays."""
    (c0, s0), (c1, s1), (c2, s2) = arm.twist_cosines
    w, L = arm.wrist_sign, arm.wrist_length_m
    t1, t2, d, t4 = q[0] + arm.offsets[0], q[1] + arm.offsets[1], q[2] + arm.offsets[2], q[3] + arm.offsets[3]
    t5, t6 = q[4] + arm.offsets[4], q[5] + arm.offsets[5]
    k1, n1, k2, n2, k4, n4 = cos(t1), sin(t1), cos(t2), sin(t2), cos(t4), sin(t4)
    k5, n5, k6, n6 = cos(t5), sin(t5), cos(t6), sin(t6)

    def base(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:  # Rx(twist 0) Rz(t1) Rx(twist 1)
        y, z = c1 * y - s1 * z, s1 * y + c1 * z
        x, y = k1 * x - n1 * y, n1 * x + k1 * y
        return x, c0 * y - s0 * z, s0 * y + c0 * z

    x3, y3, z4 = (base(k2, n2, 0.0), base(-c2 * n2, c2 * k2, s2), base(s2 * n2, -s2 * k2, c2))
    entries = []
    for a, b, z in zip(x3, y3, z4, strict=True):
        x, y = k4 * a + n4 * b, k4 * b - n4 * a
        out, side = n5 * x - w * k5 * z, w * k5 * x + n5 * z  # along the wrist link; along the jaw axis
        back = n6 * y - k6 * out
        entries += [-n6 * out - k6 * y, side, back, d * z + L * out - arm.tip_length_m * back]
    return (*entries, 0.0, 0.0, 0.0, 1.0)
