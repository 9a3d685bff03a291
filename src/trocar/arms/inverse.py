"""Closed-form inverse kinematics of every spherical remote-centre arm.

Seen from the tip, the position of the remote centre depends on wrist yaw, wrist pitch and insertion only (Pieper's
method with the end effector as base; Hwang et al. 2022, IV-C). What remains, ``Rx Rz(t1) Rx Rz(t2) Rx Rz(t4)``, is an
Euler decomposition about axes that need not be orthogonal, so it may have no solution (a cone condition). Each arm has
up to 2 x 2 x 2 branches, distinguished by the signs of cos q6, cos q5 and sin t2.

The formulas printed in the paper are wrong in two places: the remote centre in the tip frame is ``-R^T t``, not
``R^T t``, and ``R_3^z = (R_3^b)^T R^T``, not ``R_3^b R^T``; ``tests/arms/test_inverse.py`` shows both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms.forward import fk, jacobian, limit_violations
from trocar.arms.model import BRANCHES, ArmModel, SolverConstants
from trocar.checks import small
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry import SE3, TURN
from trocar.geometry.arrays import Array, finite

LIMIT_TOLERANCE = 1e-9
"""Joint values this far outside their range (rad or m) are rounding errors and are clipped to the limit."""
CONE_TOLERANCE = 1e-12  # a cosine this far beyond 1 is a rounding error
CHUNK = 8192  # number of poses solved at a time, so that the intermediate arrays stay in the cache
SMALL_CHUNK = 2048
"""Chunk for a few thousand poses: the allocator reuses such small arrays instead of returning them to the system."""

OUTER = 3  # joints before the wrist
REACHED_M = 1e-9
STEPS = 20
MAX_STEP = np.array([0.5, 0.5, 0.1])
"""Largest Newton step of yaw, pitch (rad) and insertion (m): further away, the Jacobian is no longer valid."""


def ik(
    arm: ArmModel,
    T_base_tip: SE3 | ArrayLike,
    reference: ArrayLike | None = None,
    *,
    unreachable: Literal["raise", "nan"] = "raise",
) -> Array:
    """Return the configuration(s) (..., 6) within the limits whose tip is at ``T_base_tip``.

    Of several solutions, the one nearest to ``reference`` (..., 6) is returned; all joints have equal weight, in rad
    and m. The default reference is the middle of the ranges. If the wrist or the jaw axis lies on the remote centre
    (within rounding), one wrist joint is undetermined; the result then is one of many solutions, or none.

    Args:
        arm: the robot type.
        T_base_tip: pose(s) of the tip, or their matrices (..., 4, 4).
        reference: (..., 6) joints that solutions should be near.
        unreachable: result for a pose without a solution: an error, or six NaN, so that the rest of a batch stays
            usable.

    Raises:
        OutOfReach: a pose has no solution within the limits. The message names the joint and the excess, on the
            branch with the smallest violation. Not raised with ``unreachable="nan"``.
        TrocarError: a pose or the reference is not finite, a matrix is not a pose, or the reference has the wrong
            shape.

    Example:
        >>> import numpy as np
        >>> from trocar.arms import PSM_CLASSIC, fk, ik
        >>> q = np.array([0.1, 0.2, 0.15, 0.5, 0.3, -0.2])
        >>> bool(np.allclose(ik(PSM_CLASSIC, fk(PSM_CLASSIC, q), reference=q), q))
        True
        >>> T = np.stack([fk(PSM_CLASSIC, q).matrix, np.eye(4)])  # the second one is at the remote centre
        >>> np.isfinite(ik(PSM_CLASSIC, T, unreachable="nan")).all(axis=1).tolist()
        [True, False]
    """
    if unreachable not in ("raise", "nan"):
        raise InvalidInput("unreachable", f"is {unreachable!r:.40}", "choose 'raise' or 'nan'")
    matrix = SE3.of(T_base_tip).matrix
    if matrix.ndim == 2 and (one := _six_floats(arm, reference)):
        try:
            return np.array(_solve_one(arm, matrix.tolist(), one))
        except OutOfReach:
            if unreachable == "raise":
                raise
            return np.full(6, np.nan)
    near = arm.middle if reference is None else arm.configurations(reference)
    batch = np.broadcast_shapes(matrix.shape[:-2], near.shape[:-1])
    poses = np.broadcast_to(matrix, (*batch, 4, 4)).reshape(-1, 16)
    near = np.broadcast_to(near, (*batch, 6)).reshape(-1, 6)
    q = np.empty((len(poses), 6))
    good = np.zeros(len(poses), dtype=bool)
    if arm.branch_is_unique:
        with np.errstate(divide="ignore", invalid="ignore"):
            _solve_chunks(arm, poses, None if reference is None else near, q, good)
    for k in np.flatnonzero(~good):
        try:
            q[k] = _search(arm, poses[k], near[k], f"pose {k}")
        except OutOfReach:
            if unreachable == "raise":
                raise
            q[k] = np.nan
    return q.reshape(*batch, 6)


def _solve_one(arm: ArmModel, matrix: list[list[float]], near: Sequence[float]) -> list[float]:
    if arm.branch_is_unique:
        try:
            q = closed_form(matrix, _Floats, arm.solver_constants)
        except (ValueError, ZeroDivisionError):  # outside the cone, or the wrist on the remote centre
            return _search(arm, np.ravel(matrix), np.array(near)).tolist()
        for i, low, high in arm.turn_targets:  # move yaw and roll by whole turns towards the reference
            target = near[i]
            ahead = (low if target < low else high if target > high else target) - q[i]
            if ahead > math.pi or ahead < -math.pi:
                q[i] += TURN * round(ahead / TURN)
        (a1, b1), (a2, b2), (a3, b3), (a4, b4), (a5, b5), (a6, b6) = arm.ranges
        q1, q2, q3, q4, q5, q6, _ = q
        outer = a1 <= q1 <= b1 and a2 <= q2 <= b2 and a3 <= q3 <= b3
        if outer and a4 <= q4 <= b4 and a5 <= q5 <= b5 and a6 <= q6 <= b6:
            return [q1, q2, q3, q4, q5, q6]
    return _search(arm, np.ravel(matrix), np.array(near)).tolist()


def ik_unbounded(arm: ArmModel, T_base_tip: SE3, near: Array | None = None) -> Array:
    """Return the configurations (..., 6) on the arm's own branch, within the limits or not; NaN where none is real.

    Angles are chosen, up to whole turns, nearest to ``near`` (..., 6). Without it, yaw and roll are chosen nearest to
    the middle of their ranges. Planners use this to tell how far a pose is out of reach.
    """
    matrix = T_base_tip.matrix
    poses = matrix.reshape(-1, 16)
    q, good = np.empty((len(poses), 6)), np.zeros(len(poses), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        _solve_chunks(arm, poses, None, q, good, SMALL_CHUNK)
    q = q.reshape(*matrix.shape[:-2], 6)
    return q if near is None else q - arm.turns * np.rint((q - near) / TURN)


def ik_near(arm: ArmModel, T_base_tip: SE3, near: Array) -> Array:
    """Return ``ik_unbounded`` near ``near`` (OutOfReach: one of the poses has no solution)."""
    q = ik_unbounded(arm, T_base_tip, near)
    if not np.isfinite(q).all():
        problem = f"no joints of {arm.name} have this pose of the tip, in their ranges or not"
        raise OutOfReach(f"{problem}; choose another pose")
    return q


def ik_branches(arm: ArmModel, T_base_tip: SE3) -> tuple[Array, NDArray[np.bool_]]:
    """Return all solutions, within the limits or not: q (..., 8, 6), and which of them are real (..., 8).

    The order is that of ``BRANCHES``. Angles lie within half a turn of the middle of their range. Branches that are not
    real hold values at the edge of the cone, or NaN if the wrist lies exactly on the remote centre.
    """
    matrix = T_base_tip.matrix
    m = np.moveaxis(matrix, (-2, -1), (0, 1))
    q = np.empty((*matrix.shape[:-2], 8, 6))
    real = np.empty((*matrix.shape[:-2], 8), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for b, branch in enumerate(BRANCHES):
            *joints, cosine = closed_form(m, _ClippedArrays, arm.constants(branch, arm.offsets))
            q[..., b, :] = np.stack(joints, -1)
            real[..., b] = np.abs(cosine) <= 1 + CONE_TOLERANCE
    q -= arm.turns * np.rint((q - arm.middle) / TURN)
    return q, real & np.isfinite(q).all(-1)


def ik_with_fixed_wrist(
    arm: ArmModel, q: ArrayLike, p_base_m: ArrayLike, p_tip_m: ArrayLike = (0.0, 0.0, 0.0)
) -> Array:
    """Return joints (6,) near ``q`` (6,), with unchanged roll and wrist, that bring a point to ``p_base_m`` (3,).

    ``p_tip_m`` (3,) is the point in the tip's frame: the tip itself, or a point on an object in the jaws.

    The tip turns with the shaft: by .05 rad per centimetre, 200 mm from the remote centre. The wrist's cables do not
    move, so the effects of friction and play stay as they were.

    Raises:
        OutOfReach: the point cannot be reached this way within the joints' ranges.
        TrocarError: ``q`` or a point has another shape, or is not finite.
    """
    goal, held = (finite(f"a place of arm '{arm.name}'", p_m, 3) for p_m in (p_base_m, p_tip_m))
    found = arm.configurations(q).copy()
    for _ in range(STEPS):
        T_base_tip = fk(arm, found)
        missing_m = goal - T_base_tip.apply(held)
        if np.abs(missing_m).max() < REACHED_M:
            break
        try:
            shifts, turns = np.split(jacobian(arm, found)[:, :OUTER], 2)
            of_point = shifts + np.cross(turns.T, T_base_tip.rotation.apply(held)).T
            step = np.linalg.solve(of_point, missing_m)
        except np.linalg.LinAlgError:
            raise OutOfReach(f"{arm.name} is singular on the way; turn its wrist") from None
        found[:OUTER] += np.clip(step, -MAX_STEP, MAX_STEP)
    else:
        raise OutOfReach(f"{arm.name} does not reach {np.round(1e3 * goal, 1).tolist()} mm with its wrist as it is")
    if outside := limit_violations(arm, found):
        raise OutOfReach(outside[0])
    return found


def _six_floats(arm: ArmModel, reference: ArrayLike | None) -> Sequence[float] | None:
    """Return a reference as six floats (default: middle of the ranges); None if it is not six finite numbers."""
    if reference is None:
        return arm.middle_floats
    near: Any = reference.tolist() if isinstance(reference, np.ndarray) else reference
    try:
        return near if len(near) == 6 and math.isfinite(sum(near)) else None
    except TypeError:  # not a sequence of numbers, but a batch or something else
        return None


def _solve_chunks(
    arm: ArmModel, poses: NDArray, near: NDArray | None, q: NDArray, good: NDArray, chunk: int = CHUNK
) -> None:
    """Fill ``q`` (n, 6) with the solutions of ``poses`` (n, 16) on the arm's branch, ``good`` (n,) if within limits.

    Intermediate arrays hold one quantity per row; chunks keep them in the cache.
    """
    m, columns = np.empty((4, 4, chunk)), np.empty((6, chunk))
    lower, upper = arm.lower[:, None], arm.upper[:, None]
    for start in range(0, len(poses), chunk):
        part = slice(start, start + chunk)
        n = len(poses[part])
        m[:3, :, :n] = poses[part, :12].reshape(n, 3, 4).transpose(1, 2, 0)
        *joints, _ = closed_form(m[..., :n], _Arrays, arm.solver_constants)
        for i, low, high in arm.turn_targets:
            target = arm.middle_floats[i] if near is None else np.clip(near[part, i], low, high)
            turns = target - joints[i]
            turns *= 1 / TURN
            np.rint(turns, out=turns)
            turns *= TURN
            joints[i] += turns
        for i in range(6):
            columns[i, :n] = joints[i]
        inside = columns[:, :n]
        good[part] = ((inside >= lower) & (inside <= upper)).all(0)  # NaN, outside the cone, compares false
        q[part] = inside.T


def _search(arm: ArmModel, pose: NDArray, near: NDArray, name: str = "the pose") -> Array:
    """Return the solution of one pose (16,), on any branch within the limits, that is nearest to ``near``."""
    if not np.isfinite(pose).all():
        raise InvalidInput(f"{name} for arm '{arm.name}'", "holds NaN or infinity", "check what it was computed from")
    T = SE3.unchecked(pose.reshape(4, 4))
    there = "{} at ({:.4f}, {:.4f}, {:.4f}) m".format(name, *T.translation_m)
    q, real = ik_branches(arm, T)
    if not np.isfinite(q).all(-1).any():
        why = f"the wrist lies on the remote centre and turns freely; keep it {arm.safe_depth_m} m away"
        raise OutOfReach(f"arm '{arm.name}' has no definite joint values for {there}: {why}")
    if not real.any():
        why = "no pitch points the instrument that way; turn or move the target"
        raise OutOfReach(f"arm '{arm.name}' cannot reach {there}: {why}")
    q = q[real]
    q = q + arm.turns * np.rint((near - q) / TURN)
    turned = q + arm.turns * ((q < arm.lower) * 1.0 - (q > arm.upper))
    q = np.where(_excess(arm, turned) < _excess(arm, q), turned, q)
    excess = _excess(arm, q)
    inside = (excess <= LIMIT_TOLERANCE).all(-1)
    if inside.any():
        q = q[inside]
        return np.clip(q[np.argmin(((q - near) ** 2).sum(-1))], arm.lower, arm.upper)
    best = np.argmin(excess.max(-1))
    i = int(np.argmax(excess[best]))
    joint = arm.joints[i]
    outside = f"{small(excess[best, i])} outside [{joint.lower:.4f}, {joint.upper:.4f}] {joint.unit}"
    why = f"joint '{joint.name}' would be {q[best, i]:.4f} {joint.unit}, {outside}; move or turn the target"
    raise OutOfReach(f"arm '{arm.name}' cannot reach {there}: {why}")


def _excess(arm: ArmModel, q: NDArray) -> Array:
    """Return how far each joint is outside its range; negative inside."""
    return np.maximum(arm.lower - q, q - arm.upper)


class _Floats:
    """The functions that ``closed_form`` needs, for floats."""

    copysign, sqrt, root, atan2, atan2_right = math.copysign, math.sqrt, math.sqrt, math.atan2, math.atan2


class _Arrays:
    """The functions that ``closed_form`` needs, for arrays; NaN outside the cone."""

    copysign, sqrt, root = np.copysign, np.sqrt, np.sqrt

    @staticmethod
    def atan2(y: NDArray, x: NDArray) -> NDArray:
        """Return ``np.arctan2(y, x)``, computed by ``np.arctan``, which is three times faster."""
        return np.copysign(math.pi / 2, y) - np.arctan(x / y)

    @staticmethod
    def atan2_right(y: NDArray, x: NDArray) -> NDArray:
        """Return ``np.arctan2(y, x)`` for x >= 0."""
        return np.arctan(y / x)


class _ClippedArrays(_Arrays):
    """The same functions; outside the cone, they give the results at its edge."""

    @staticmethod
    def root(x: NDArray) -> NDArray:
        """Return the square root, or 0 for negative numbers."""
        return np.sqrt(np.maximum(x, 0.0))


def closed_form(m: Any, xp: Any, constants: SolverConstants) -> list[Any]:
    """Return q1..q6 of one branch, up to whole turns, and cos t2, which exceeds 1 outside the cone.

    Args:
        m: the four rows of ``T_base_tip`` (the last is not read), of floats, arrays or intervals.
        xp: ``_Floats``, ``_Arrays`` or a counterpart for intervals.
        constants: constants of the arm and the branch.
    """
    (r00, r01, r02, px), (r10, r11, r12, py), (r20, r21, r22, pz), _ = m
    (u6, u5, u2), w, link, tip, c0, s0, c1c2, s1s2, s1c2, c1s2, u_s1, u_s2, (o1, o2, o3, o4, o5, o6) = constants
    sqrt, atan2, atan2_right, copysign = xp.sqrt, xp.atan2, xp.atan2_right, xp.copysign
    # rotate the base by the first twist, so that axis 1 is z
    if c0 == 0.0:
        r10, r20, r11, r21 = s0 * r20, -s0 * r10, s0 * r21, -s0 * r11
        r12, r22, py, pz = s0 * r22, -s0 * r12, s0 * pz, -s0 * py
    elif s0 != 0.0 or c0 < 0.0:
        r10, r20 = c0 * r10 + s0 * r20, c0 * r20 - s0 * r10
        r11, r21 = c0 * r11 + s0 * r21, c0 * r21 - s0 * r11
        r12, r22 = c0 * r12 + s0 * r22, c0 * r22 - s0 * r12
        py, pz = c0 * py + s0 * pz, c0 * pz - s0 * py
    # the jaw axis seen from the remote centre, in the tip's axes: R^T p + (0, 0, tip)
    cx = r00 * px
    cx += r10 * py
    cx += r20 * pz
    cy = r01 * px
    cy += r11 * py
    cy += r21 * pz
    cz = r02 * px
    cz += r12 * py
    cz += r22 * pz
    cz += tip
    reach = copysign(sqrt(cx * cx + cz * cz), cz if u6 > 0 else -cz)
    n6, k6 = cx / reach, cz / reach
    axial = reach + link  # depth of the pitch axis times w cos q5
    wu = w * u5
    depth = copysign(sqrt(axial * axial + cy * cy), axial if wu > 0 else -axial)
    n5, k5 = cy / depth, axial / depth  # sin q5, w cos q5
    # axis 1 in the tip's frame, then in frame 4: (a4, b4, k); its part k along the shaft fixes t2
    g = n6 * r20 + k6 * r22
    a4, b4, k = k5 * r21 - n5 * g, n6 * r22 - k6 * r20, k5 * g + n5 * r21
    k2 = (c1c2 - k) / s1s2
    n2 = xp.root(1.0 - k2 * k2)  # sin t2 without its sign
    # axis 1 in frame 3: it differs from frame 4 by the roll alone
    a3, b3 = u_s1 * n2, s1c2 * k2 + c1s2
    # axis 4 seen along axis 1: (x, y) is its direction, (x0, -y0) its direction at t1 = 0; t1 is the angle between
    a, b = k5 * n6, k5 * k6
    x = r00 * a + r01 * n5 + r02 * b
    y = r10 * a + r11 * n5 + r12 * b
    x0, y0 = u_s2 * n2, c1s2 * k2 + s1c2
    q5, q6 = atan2_right(n5, k5 if wu > 0 else -k5), atan2_right(n6, k6 if u6 > 0 else -k6)
    return [
        atan2(y * x0 + x * y0, x * x0 - y * y0) - o1,
        (u2 * math.pi / 2 - o2) - u2 * atan2_right(k2, n2),
        depth - o3,
        atan2(b3 * a4 - a3 * b4, a3 * a4 + b3 * b4) - o4,
        (q5 if u5 > 0 else math.pi - q5) - o5,
        (q6 if u6 > 0 else math.pi - q6) - o6,
        k2,
    ]
