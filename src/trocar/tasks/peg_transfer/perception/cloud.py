"""Pose of a block from an unordered cloud of points on its top face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.perception.outline import TopFace, top_face
from trocar.tasks.peg_transfer.shapes import Block

MIN_POINTS = 60
PLANE_GATES_M = (4e-3, 2.5e-3, 1.5e-3)
PLANE_STEPS = 3
YAWS = 12
OFFSETS_M = (-2e-3, 0.0, 2e-3)
COARSE_POINTS = 150
FINALISTS = 3
FINE_POINTS = 300
STEPS = 15
MAX_RMS_M = 1.0e-3
MIN_COVERED = 0.4
COVER_M = 0.7e-3


@dataclass(frozen=True, eq=False)
class CloudFit:
    """Result of ``fit_cloud``.

    Attributes:
        found: whether the cloud shows a block's top face.
        reason: one sentence: why not, or that it does.
        T_capture_block: pose in the cloud's frame, with one of three equivalent yaws; None if no fit was possible.
        rms_m: root mean square distance of the points on the plane from the face.
        inliers: number of points on the plane.
        covered: share of the face that is near points.
    """

    found: bool
    reason: str
    T_capture_block: SE3 | None
    rms_m: float
    inliers: int
    covered: float


def fit_cloud(points_m: ArrayLike, block: Block) -> CloudFit:
    """Return the block's pose from points (n, 3) in m, seen from their frame's origin.

    A plane is fitted with shrinking gates; in the plane, the distance of the points from the face is minimised. This is
    the result to which point-to-point ICP on a dense model converges. The search starts from all yaws and nine offsets.

    Raises:
        InvalidInput: the shape is wrong, there are fewer than 60 points, or points are not finite.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[-1] != 3:
        raise InvalidInput("a capture", f"needs points of shape (n, 3), got {points.shape}")
    if len(points) < MIN_POINTS:
        raise InvalidInput("a capture", f"needs at least {MIN_POINTS} points, got {len(points)}")
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points).all(-1)).sum())
        raise InvalidInput("the capture", f"holds {bad} points that are NaN or infinite", "remove them")

    T_capture_face, near = _face_plane(points)
    if near.sum() < MIN_POINTS:
        return CloudFit(False, "the points form no plane", None, float("nan"), int(near.sum()), 0.0)
    local = T_capture_face.inverse().apply(points[near])
    face = top_face(block)
    xy = local[:, :2]
    few = _thin(xy, FINE_POINTS)
    ends = [_refine(face, few, start) for start in _coarse(face, _thin(xy, COARSE_POINTS))]
    pose, _ = _refine(face, xy, min(ends, key=lambda end: end[1])[0])
    outside = np.maximum(-face.at(_to_face(xy, pose)), 0.0)
    rms = float(np.sqrt(np.mean(outside**2 + local[:, 2] ** 2)))
    covered = _covered(block, xy, pose)
    T = T_capture_face @ SE3.from_parts(SO3.axis("z", pose[2]), [pose[0], pose[1], 0.0])
    found = rms < MAX_RMS_M and covered > MIN_COVERED
    reason = "found" if found else f"rms {rms * 1e3:.2f} mm, {covered:.0%} of the face covered: not a block's top face"
    return CloudFit(found, reason, T, rms, int(near.sum()), covered)


def _face_plane(points: NDArray[np.float64]) -> tuple[SE3, NDArray[np.bool_]]:
    """Return a frame on the face, z away from the viewer, and which points lie on the face."""
    near = np.ones(len(points), dtype=bool)
    middle, normal = points.mean(0), points.mean(0)
    for gate in PLANE_GATES_M:
        for _ in range(PLANE_STEPS):
            middle = points[near].mean(0)
            off = points[near] - middle
            _, vectors = np.linalg.eigh(off.T @ off)
            normal = vectors[:, 0]
            near = np.abs((points - middle) @ normal) < gate
            if near.sum() < 3:
                return SE3.identity(), near
    z = normal if normal @ middle >= 0 else -normal
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3.unchecked(np.column_stack([x, np.cross(z, x), z])), middle), near


def _thin(xy: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    return xy[:: max(1, len(xy) // count)]


def _to_face(xy: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 2) in the frame of a face at x, y, yaw (3,), or of many faces (3, k, 1) as (k, n, 2)."""
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = xy[:, 0] - pose[0], xy[:, 1] - pose[1]
    return np.stack([cosine * dx + sine * dy, cosine * dy - sine * dx], -1)


def _coarse(face: TopFace, xy: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the best starting poses of a grid over yaw and offset from the points' middle."""
    middle = (xy.max(0) + xy.min(0)) / 2
    starts = [
        np.array([middle[0] + x, middle[1] + y, yaw])
        for yaw in np.radians(120.0) * np.arange(YAWS) / YAWS
        for x in OFFSETS_M
        for y in OFFSETS_M
    ]
    local = _to_face(xy, np.array(starts).T[..., None])
    cost = np.mean(np.minimum(face.nearest(local), 0.0) ** 2, -1)
    return [starts[i] for i in np.argsort(cost)[:FINALISTS]]


def _refine(face: TopFace, xy: NDArray[np.float64], start: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return x, y, yaw with the minimum mean square distance to the face (Levenberg-Marquardt), and this distance."""
    pose, damping = start, 1e-4
    residual, jacobian = _outside(face, xy, pose)
    loss = float(residual @ residual)
    for _ in range(STEPS):
        hessian = jacobian.T @ jacobian
        step = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian) + 1e-12), -jacobian.T @ residual)
        trial = pose + step
        residual_there, jacobian_there = _outside(face, xy, trial)
        loss_there = float(residual_there @ residual_there)
        if loss_there < loss:
            pose, residual, jacobian, loss, damping = trial, residual_there, jacobian_there, loss_there, damping / 5
        else:
            damping *= 8
        if np.hypot(step[0], step[1]) < 2e-6 and abs(step[2]) < 2e-4:
            break
    return pose, loss / len(xy)


def _outside(
    face: TopFace, xy: NDArray[np.float64], pose: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far points (n,) lie outside the face at a pose, and the Jacobian (n, 3) of this distance."""
    local = _to_face(xy, pose)
    depth = face.at(local)
    out = depth < 0
    slope = -face.slope(local) * out[:, None]
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    dx = -slope[:, 0] * cosine + slope[:, 1] * sine
    dy = -slope[:, 0] * sine - slope[:, 1] * cosine
    dyaw = slope[:, 0] * local[:, 1] - slope[:, 1] * local[:, 0]
    return np.where(out, -depth, 0.0), np.stack([dx, dy, dyaw], -1)


def _covered(block: Block, xy: NDArray[np.float64], pose: NDArray[np.float64]) -> float:
    """Return the share of the face's area that has points nearby, counted on a square grid."""
    step = 2 * COVER_M
    cells = {tuple(c) for c in np.floor(_to_face(xy, pose) / step).astype(int)}
    wanted = {tuple(c) for c in np.floor(block.top_face_m(0.3e-3)[:, :2] / step).astype(int)}
    return len(cells & wanted) / len(wanted)
