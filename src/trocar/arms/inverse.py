"""Closed-form inverse kinematics of every spherical remote-centre arm.

Seen from the tip, the remote centre is a point that wrist yaw, wrist pitch and insertion alone place (Pieper's method
with the end effector as base; Hwang et al. 2022, IV-C). What is left, ``Rx Rz(t1) Rx Rz(t2) Rx Rz(t4)``, is an Euler
decomposition about axes that need not be orthogonal, so that it can be infeasible (a cone condition). Each arm has up
to 2 x 2 x 2 branches, told apart by the signs of cos q6, cos q5 and sin t2.

The formulas printed in the paper are wrong twice: the remote centre in the tip frame is ``-R^T t``, not ``R^T t``, and
``R_3^z = (R_3^b)^T R^T``, not ``R_3^b R^T``. ``tests/arms/test_inverse.py`` shows the printed ones fail.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms.model import ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3

TAU = 2 * math.pi
LIMIT_TOLERANCE = 1e-9
"""Joint values this far outside their range (rad or m) count as rounding and are put back on the limit."""
CHUNK = 1024
"""Poses solved at a time: the intermediate arrays of a chunk stay in the cache."""
SIGNS = tuple((u6, u5, u2) for u6 in (1, -1) for u5 in (1, -1) for u2 in (1, -1))
"""The branches: signs of cos q6, cos q5, sin t2."""


NUDGE_M = 1e-150
"""Keeps the two wrist singularities (0 / 0) defined; far below rounding, its square does not underflow."""


class Unreachable(TrocarError):
    """No configuration within the joint limits reaches a pose."""


def ik(arm: ArmModel, T_base_tip: SE3, reference: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return the configuration(s) (..., 6) within the limits whose tip lies at ``T_base_tip``.

    Of several, the one nearest to ``reference`` (..., 6) is taken: the joints count alike, in rad and m. The default
    reference is the middle of the ranges.

    Raises:
        Unreachable: a pose has no solution within the limits; says which joint is how far outside, on the branch
            that violates least.
        TrocarError: a pose or the reference is not finite or has the wrong shape.
    """
    matrix = T_base_tip.matrix
    if matrix.ndim == 2 and (reference is None or np.ndim(reference) == 1):
        return np.array(ik_floats(arm, matrix.ravel().tolist(), reference))
    ref = arm.middle if reference is None else arm.configurations(reference)
    batch = np.broadcast_shapes(matrix.shape[:-2], ref.shape[:-1])
    poses = np.broadcast_to(matrix, (*batch, 4, 4)).reshape(-1, 16)
    if ref.ndim > 1:
        ref = np.broadcast_to(ref, (*batch, 6)).reshape(-1, 6)
    q = np.empty((len(poses), 6))
    for start in range(0, len(poses), CHUNK):
        part = slice(start, start + CHUNK)
        _ik_chunk(arm, poses[part], ref if ref.ndim == 1 else ref[part], q[part])
    return q.reshape(*batch, 6)


def ik_floats(arm: ArmModel, matrix: list[float], reference: ArrayLike | None = None) -> list[float]:
    """Return ``ik`` of one pose given as the 16 entries of its matrix, row by row; no array is touched."""
    near = arm.middle_floats if reference is None else _reference_floats(arm, reference)
    if arm.branch_is_unique:
        try:
            q = _solve(arm, matrix, *arm.principal_signs, math)
        except ValueError:  # the square root of a negative number: outside the cone
            q = None
        if q is not None:
            for i, (low, high, turns) in enumerate(arm.ranges):
                x = q[i]
                if turns:
                    x += TAU * round((near[i] - x) / TAU)
                    if x > high:
                        x -= TAU
                    elif x < low:
                        x += TAU
                    q[i] = x
                if not low <= x <= high:
                    break
            else:
                return q[:6]
    return _search(arm, np.array(matrix), np.array(near)).tolist()


def ik_branches(arm: ArmModel, T_base_tip: SE3) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return every solution, in or out of the limits: q (..., 8, 6) and whether each is real (..., 8).

    The order is that of ``SIGNS``. Angles lie within half a turn of the middle of their range; branches that are not
    real hold the nearest values on the edge of the cone.
    """
    matrix = T_base_tip.matrix
    m = list(np.moveaxis(matrix.reshape(*matrix.shape[:-2], 16), -1, 0))
    q = np.empty((*matrix.shape[:-2], 8, 6))
    real = np.empty((*matrix.shape[:-2], 8), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for b, signs in enumerate(SIGNS):
            values = _solve(arm, m, *signs, _Arrays)
            for i, value in enumerate(values[:6]):
                q[..., b, i] = value
            real[..., b] = np.abs(values[6]) <= 1 + 1e-12
    turning = [0, 1, 3, 4, 5]
    q[..., turning] -= TAU * np.rint((q[..., turning] - arm.middle[turning]) / TAU)
    return q, real & np.isfinite(q).all(-1)


def _ik_chunk(arm: ArmModel, poses: NDArray, reference: NDArray, q: NDArray) -> None:
    """Fill ``q`` (n, 6) with the solutions of ``poses`` (n, 16)."""
    if arm.branch_is_unique:
        m = list(np.ascontiguousarray(poses.T))
        with np.errstate(divide="ignore", invalid="ignore"):
            values = _solve(arm, m, *arm.principal_signs, _Arrays)
        good = np.abs(values[6]) <= 1
        for i, (low, high, turns) in enumerate(arm.ranges):
            x = values[i]
            if turns:
                x -= TAU * np.rint((x - reference[..., i]) * (1 / TAU))
                x -= TAU * (x > high)
                x += TAU * (x < low)
            good &= x >= low
            good &= x <= high
            q[:, i] = x
        rest = np.flatnonzero(~good)
    else:
        rest = np.arange(len(poses))
    for k in rest:
        q[k] = _search(arm, poses[k], reference if reference.ndim == 1 else reference[k], int(k))


def _search(arm: ArmModel, pose: NDArray, near: NDArray, index: int | None = None) -> NDArray[np.float64]:
    """Return the solution of one pose (16,) within the limits nearest to ``near``, among all branches and turns."""
    if not np.isfinite(pose).all():
        raise TrocarError(f"arm '{arm.name}' cannot reach a pose that holds NaN or infinity")
    T = SE3(pose.reshape(4, 4))
    q, real = ik_branches(arm, T)
    where = "the pose" if index is None else f"pose {index}"
    p = ", ".join(f"{x:.4f}" for x in T.translation_m)
    if not real.any():
        raise Unreachable(
            f"arm '{arm.name}' cannot reach {where} at ({p}) m: no pitch of the arm points the instrument that way; "
            "turn or move the target"
        )
    q = q[real]
    turn = np.where([joint.prismatic for joint in arm.joints], 0.0, TAU)
    q = q + turn * np.rint((near - q) / TAU)
    q = q + turn * ((q < arm.lower - LIMIT_TOLERANCE).astype(float) - (q > arm.upper + LIMIT_TOLERANCE))
    excess = np.maximum(arm.lower - q, q - arm.upper)
    inside = np.all(excess <= LIMIT_TOLERANCE, axis=-1)
    if inside.any():
        q = q[inside]
        best = q[np.argmin(np.sum((q - near) ** 2, -1))]
        return np.clip(best, arm.lower, arm.upper)
    branch = np.argmin(excess.max(-1))
    i = int(np.argmax(excess[branch]))
    joint = arm.joints[i]
    raise Unreachable(
        f"arm '{arm.name}' cannot reach {where} at ({p}) m: joint '{joint.name}' would be {q[branch, i]:.4f} "
        f"{joint.unit}, {excess[branch, i]:.4f} {joint.unit} outside [{joint.lower:.4f}, {joint.upper:.4f}]; "
        "move or turn the target"
    )


class _Arrays:
    """What ``_solve`` needs of ``math``, for arrays; outside the cone the edge is taken."""

    copysign = np.copysign

    @staticmethod
    def sqrt(x: NDArray) -> NDArray:
        return np.sqrt(np.maximum(x, 0.0))

    @staticmethod
    def atan2(y: NDArray, x: NDArray) -> NDArray:
        """Return ``np.arctan2(y, x)`` by ``np.arctan``, which is three times faster."""
        return np.arctan(y / x) + np.copysign(math.pi, y) * (x < 0)


def _reference_floats(arm: ArmModel, reference: ArrayLike) -> list[float]:
    if type(reference) is not list or len(reference) != 6:
        return arm.configurations(reference).tolist()
    return reference


def _solve(arm: ArmModel, m: Any, u6: int, u5: int, u2: int, xp: Any) -> list[Any]:
    """Return q1..q6 of one branch (whole turns still free) and cos t2, which is beyond 1 outside the cone.

    ``m`` are the 16 entries of ``T_base_tip``, floats with ``xp`` = math or arrays with one of the classes below.
    """
    r00, r01, r02, px, r10, r11, r12, py, r20, r21, r22, pz = m[:12]
    w, L = arm.wrist_sign, arm.wrist_length_m
    # remote centre seen from the jaw axis, along the tip's axes: c = -R^T p + (0, 0, -tip)
    cx = -(r00 * px + r10 * py + r20 * pz)
    cy = -(r01 * px + r11 * py + r21 * pz)
    cz = -(r02 * px + r12 * py + r22 * pz) - arm.tip_length_m
    cz = cz + xp.copysign(NUDGE_M, cz)
    reach = xp.sqrt(cx * cx + cz * cz)
    e = u6 * xp.copysign(1.0, cz)
    n6, k6 = e * cx / reach, e * cz / reach
    depth_cos = e * reach - L  # depth * cos t5
    depth_cos = depth_cos + xp.copysign(NUDGE_M, depth_cos)
    depth_sin = w * cy  # depth * sin t5
    depth = u5 * xp.copysign(xp.sqrt(depth_cos * depth_cos + cy * cy), depth_cos)
    n5, k5 = depth_sin / depth, depth_cos / depth
    # axes z and y of frame 4 in the base
    a, b, c = w * n6 * k5, n5, w * k6 * k5
    zx, zy, zz = r00 * a + r01 * b + r02 * c, r10 * a + r11 * b + r12 * c, r20 * a + r21 * b + r22 * c
    yx, yy, yz = r02 * n6 - r00 * k6, r12 * n6 - r10 * k6, r22 * n6 - r20 * k6
    (c0, s0), (c1, s1), (c2, s2) = arm.twist_cosines
    zy, zz = c0 * zy + s0 * zz, c0 * zz - s0 * zy
    k2 = (c1 * c2 - zz) / (s1 * s2)
    n2 = u2 * xp.sqrt(1.0 - k2 * k2)
    t2 = xp.atan2(n2, k2)
    x, y = s2 * n2, -c1 * s2 * k2 - s1 * c2
    t1 = xp.atan2(zy * x - zx * y, zx * x + zy * y)
    # axis 1 seen in frames 3 and 4
    a3, b3 = s1 * n2, s1 * c2 * k2 + c1 * s2
    b4 = c0 * yz - s0 * yy
    xz = (r20 * -n5 * n6 + w * k5 * r21 - r22 * n5 * k6) * c0 - s0 * (
        r10 * -n5 * n6 + w * k5 * r11 - r12 * n5 * k6
    )
    t4 = xp.atan2(b3 * xz - a3 * b4, a3 * xz + b3 * b4)
    o = arm.offsets
    return [
        t1 - o[0],
        t2 - o[1],
        -w * depth - o[2],
        t4 - o[3],
        xp.atan2(n5, k5) - o[4],
        xp.atan2(n6, k6) - o[5],
        k2,
    ]
