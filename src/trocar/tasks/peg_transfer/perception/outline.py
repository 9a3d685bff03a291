"""The outline of a block's top face, and its fit in the plane to pixels that show the face or its absence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.geometry import TURN
from trocar.tasks.peg_transfer.shapes import Block

STEP_M = 0.2e-3
REACH_M = 14e-3


@dataclass(frozen=True, eq=False)
class TopFace:
    """Signed distance to the outline of the top face in the block frame's x, y: positive on the face.

    Attributes:
        distance_m: (n, n) distance at the nodes ``-REACH_M + k STEP_M``, indexed [x, y].
        gradient: (n, n, 2) its gradient with respect to x, y.
        area_m2: area of the face.
    """

    distance_m: NDArray[np.float64]
    gradient: NDArray[np.float64]
    area_m2: float

    def at(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (...) at points (..., 2), bilinear between nodes and constant beyond the border."""
        i, j, a, b = _cell(xy_m, len(self.distance_m))
        d = self.distance_m
        return (1 - a) * ((1 - b) * d[i, j] + b * d[i, j + 1]) + a * ((1 - b) * d[i + 1, j] + b * d[i + 1, j + 1])

    def nearest(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance (...) at the nodes nearest to points (..., 2), which is coarse but fast."""
        at = np.clip(np.rint((xy_m + REACH_M) / STEP_M), 0, len(self.distance_m) - 1).astype(np.intp)
        return self.distance_m[at[..., 0], at[..., 1]]

    def slope(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the gradient (..., 2) at the nearest node."""
        i, j, a, b = _cell(xy_m, len(self.distance_m))
        return self.gradient[i + (a > 0.5), j + (b > 0.5)]


def _cell(xy_m: NDArray[np.float64], count: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    at = np.clip((xy_m + REACH_M) / STEP_M, 0, count - 1.001)
    node = at.astype(np.intp)
    part = at - node
    return node[..., 0], node[..., 1], part[..., 0], part[..., 1]


@lru_cache(maxsize=8)
def top_face(block: Block) -> TopFace:
    """Return the map of this block's top face."""
    angle = np.linspace(0, TURN, 720, endpoint=False)
    radius = np.concatenate([block.hole_radius_m(angle), block.outer_radius_m(angle)])
    both = np.concatenate([angle, angle])
    outline = KDTree(np.column_stack([radius * np.cos(both), radius * np.sin(both)]))
    ticks = np.arange(round(2 * REACH_M / STEP_M) + 1) * STEP_M - REACH_M
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    r, a = np.hypot(x, y), np.arctan2(y, x)
    inside = (r >= block.hole_radius_m(a)) & (r <= block.outer_radius_m(a))
    distance = outline.query(np.stack([x, y], -1))[0] * np.where(inside, 1.0, -1.0)
    gradient = np.stack(np.gradient(distance, STEP_M), -1)
    return TopFace(distance, gradient, float(inside.sum()) * STEP_M**2)


COARSE_YAWS = 24
COARSE_STEP_M = 1.0e-3
COARSE_REACH_M = 3.0e-3
COARSE_PIXELS = 300
FINALISTS = 3
SOFTNESS_M = 0.25e-3
"""Half a pixel: width of the soft edge over which a pixel's label fades."""

STEPS = 15
CONTRADICTION_M = 0.4e-3


@dataclass(frozen=True)
class Outline:
    """Pose of the outline, and how well it fits.

    Attributes:
        x_m: x of its middle.
        y_m: y of its middle.
        yaw_rad: angle of the block's x axis about z, which points to the viewer, in [0, 120 deg).
        mismatch: number of pixels that contradict the outline, relative to the number that show the face.
        covered: share of the pixels that show the face and lie inside the outline.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    mismatch: float
    covered: float


def fit_outline(face: TopFace, xy_m: NDArray[np.float64], shows_face: NDArray[np.bool_]) -> Outline:
    """Return x, y, yaw that minimise sum (shows_face - s(d / w))^2, d = signed distance inside the outline.

    The best three poses of a grid over all yaws and offsets are refined by Levenberg-Marquardt, so no initial guess is
    needed.

    Args:
        face: the outline.
        xy_m: (n, 2) where each pixel's ray meets the plane of the face, z towards the viewer.
        shows_face: (n,) whether the ray ends there.
    """
    label = shows_face.astype(np.float64)
    centre = xy_m[shows_face].mean(0)
    pose, loss = np.zeros(3), np.inf
    for start in _coarse(face, xy_m, label, centre):
        refined, refined_loss = _refine(face, xy_m, label, start)
        if refined_loss < loss:
            pose, loss = refined, refined_loss
    distance = face.at(_to_block(xy_m, pose)[0])
    shown = int(shows_face.sum())
    lost = int((shows_face & (distance < -CONTRADICTION_M)).sum())
    bare = int((~shows_face & (distance > CONTRADICTION_M)).sum())
    x, y, yaw = (float(v) for v in pose)
    return Outline(x, y, yaw % np.radians(120.0), (lost + bare) / max(shown, 1), 1 - lost / max(shown, 1))


def _to_block(xy_m: NDArray[np.float64], pose: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Return points in the block's x, y (its z points away from the viewer), and the cosine and sine of yaw."""
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = xy_m[:, 0] - pose[0], xy_m[:, 1] - pose[1]
    return np.stack([cosine * dx + sine * dy, sine * dx - cosine * dy], -1), cosine, sine


def _coarse(
    face: TopFace, xy_m: NDArray[np.float64], label: NDArray[np.float64], centre: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return the best starting poses of a grid over yaw and offset from the middle of the face's pixels."""
    every = max(1, len(xy_m) // COARSE_PIXELS)
    points, sign = xy_m[::every] - centre, 2 * label[::every] - 1
    ticks = np.arange(-COARSE_REACH_M, COARSE_REACH_M + COARSE_STEP_M / 2, COARSE_STEP_M)
    offsets = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)
    yaws = np.radians(120.0) * np.arange(COARSE_YAWS) / COARSE_YAWS
    delta = (points[None] - offsets[:, None])[None]
    cosine, sine = np.cos(yaws)[:, None, None], np.sin(yaws)[:, None, None]
    local = np.stack([cosine * delta[..., 0] + sine * delta[..., 1], sine * delta[..., 0] - cosine * delta[..., 1]], -1)
    score = np.sum(sign * np.clip(face.nearest(local), -5e-4, 5e-4), -1)
    best = np.argsort(score, axis=None)[::-1]
    starts: list[NDArray[np.float64]] = []
    for flat in best[:200]:
        yaw_index, offset_index = np.unravel_index(flat, score.shape)
        start = np.array([*(centre + offsets[offset_index]), yaws[yaw_index]])
        if all(_apart(start, other) for other in starts):
            starts.append(start)
        if len(starts) == FINALISTS:
            break
    return starts


def _apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    turn = np.radians(120.0)
    yaw = abs((a[2] - b[2] + turn / 2) % turn - turn / 2)
    return bool(yaw > np.radians(12.0) or np.hypot(*(a[:2] - b[:2])) > 2e-3)


def _refine(
    face: TopFace, xy_m: NDArray[np.float64], label: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the pose refined by Levenberg-Marquardt on soft labels, and its mean square residual."""
    pose, damping = start, 1e-3
    residual, jacobian = _residual(face, xy_m, label, pose)
    loss = float(residual @ residual)
    for _ in range(STEPS):
        hessian = jacobian.T @ jacobian
        scale = np.diag(np.diag(hessian) + 1e-9)
        step = np.linalg.solve(hessian + damping * scale, -jacobian.T @ residual)
        trial = pose + step
        trial_residual, trial_jacobian = _residual(face, xy_m, label, trial)
        trial_loss = float(trial_residual @ trial_residual)
        if trial_loss < loss:
            pose, residual, jacobian, loss, damping = (
                trial,
                trial_residual,
                trial_jacobian,
                trial_loss,
                damping / 5,
            )
        else:
            damping *= 8
        if np.hypot(*step[:2]) < 2e-6 and abs(step[2]) < 2e-4:
            break
    return pose, loss / len(xy_m)


def _residual(
    face: TopFace, xy_m: NDArray[np.float64], label: NDArray[np.float64], pose: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the residuals (n,) of the soft labels at a pose, and their Jacobian (n, 3)."""
    local, cosine, sine = _to_block(xy_m, pose)
    soft = 1 / (1 + np.exp(-np.clip(face.at(local) / SOFTNESS_M, -30, 30)))
    slope = face.slope(local)
    chain = (soft * (1 - soft) / SOFTNESS_M)[:, None]
    dx = -slope[:, 0] * cosine - slope[:, 1] * sine
    dy = -slope[:, 0] * sine + slope[:, 1] * cosine
    dyaw = -slope[:, 0] * local[:, 1] + slope[:, 1] * local[:, 0]
    return soft - label, chain * np.stack([dx, dy, dyaw], -1)
