"""Pose of a block on a peg, or in an arm's jaws, from one colour and depth image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.errors import InvalidValue
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.geometry.arrays import Array
from trocar.perception.color import red_mask
from trocar.perception.depth import Patch, patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

WINDOW_M = 13e-3
"""Half-width of the window round the peg: outline 8.95 mm, clearance 3.2 mm, and a pixel."""
PEG_GUARD_M = 2.4e-3
"""Surfaces this close to the peg's axis belong to the peg (the authors' ring begins at 2.5 mm)."""
HEIGHT_WINDOW_M = 2.5e-3
STEP_DOWN_M = 0.6e-3
"""A surface this far below the top plane is not the top face: three SD of depth noise. The outline is fitted halfway
down, because the upper edge of the walls counts as face."""
STEP_UP_M = 1.0e-3
MIN_VISIBLE = 0.30
MAX_MISMATCH = 0.22
MAX_TILT_RAD, MAX_HELD_TILT_RAD = np.radians(8.0), np.radians(14.0)
"""Largest tilt of a block on the board, and in jaws, where it tilts with the wrist. Tilted further, a face of 8.95 mm
radius leaves the window of heights."""
MIN_POINTS = 40

NODE_M, MAP_M = 0.2e-3, 14e-3
"""Spacing of the nodes of a face's map, and its half-width."""
YAWS_RAD = np.radians(120.0) * np.arange(24) / 24
OFFSET_STEP_M, OFFSET_REACH_M = 1.0e-3, 3.0e-3
FINALISTS = 3
"""Number of poses that are refined, from a grid over all yaws and offsets: no initial guess is needed."""
COARSE_PIXELS = 300
SOFTNESS_M = 0.25e-3
"""Half a pixel: width of the soft edge over which a pixel's label fades."""
REFINEMENTS = 15
CONTRADICTION_M = 0.4e-3


def find_block(image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block, peg: int) -> SE3 | str:
    """Return the pose in the board's frame of the block on a peg, or one sentence why there is none.

    A plane is fitted to the red pixels at the height of the top face. Each pixel's ray then either ends on this plane
    (and shows the face) or passes through it (and shows that there is none). The outline's x, y and yaw are fitted to
    both kinds of pixels; pixels that end above the plane (peg, tool) or have no depth carry no information. The yaw is
    one of three equivalent ones.

    Raises:
        InvalidValue: the peg does not exist.
    """
    pegs = board.pegs_m
    if not 0 <= peg < len(pegs):
        raise InvalidValue("the peg's number", peg, f"the board has pegs 0 to {len(pegs) - 1}")
    others = np.delete(pegs, peg, 0)[:, :2] - pegs[peg][:2]
    return _find_around(
        image, T_camera_board, pegs[peg] + [0, 0, block.height_m], block, others, MAX_TILT_RAD, f"peg {peg}"
    )


def find_held_block(image: RgbdImage, T_camera_board: SE3, block: Block, T_board_expected: SE3) -> SE3 | str:
    """Return the pose in the board's frame of a nearly upright block in the jaws of an arm, or why there is none.

    Works like ``find_block``, but without pegs; pixels that the jaws hide carry no information. The block has to be
    within some millimetres of its expected pose, which follows from the arm's joints.
    """
    at = T_board_expected.translation_m
    return _find_around(image, T_camera_board, at, block, np.zeros((0, 2)), MAX_HELD_TILT_RAD, "the block in the jaws")


def _find_around(
    image: RgbdImage, T_camera_board: SE3, top_m: Array, block: Block, others_m: Array, max_tilt_rad: float, what: str
) -> SE3 | str:
    """Return the pose of the block whose top face is near a point (3,) in the board's frame, or why there is none."""
    T_board_top = SE3.from_parts(translation_m=top_m)
    half = np.array([WINDOW_M, WINDOW_M, 1e-3])
    patch = patch_around(image, T_camera_board @ T_board_top, -half, half)
    if patch is None:
        return f"{what} lies outside the image"
    found = _find_in_window(patch, T_camera_board @ T_board_top, block, others_m, max_tilt_rad)
    return found if isinstance(found, str) else T_board_top @ found


def _find_in_window(patch: Patch, T_camera_top: SE3, block: Block, others_m: Array, max_tilt_rad: float) -> SE3 | str:
    """Return the block's pose in the frame of its expected top face (``T_camera_top``), or why there is none."""
    T_top_camera = T_camera_top.inverse()
    rays = patch.rays @ T_top_camera.rotation.matrix.T
    eye = T_top_camera.translation_m
    points = eye + rays * patch.depth_m[..., None]
    radius = np.hypot(points[..., 0], points[..., 1])
    candidate = (
        (np.abs(points[..., 2]) < HEIGHT_WINDOW_M)
        & (radius > PEG_GUARD_M)
        & (radius < WINDOW_M)
        & _nearest_here(points[..., :2], others_m)
        & red_mask(patch.color)
    )
    face = top_face(block)
    expected = face.area_m2 / _pixel_area(rays, eye)
    min_count = max(MIN_POINTS, MIN_VISIBLE * expected)
    count = int(candidate.sum())
    if count < min_count:
        return f"only {count} of {expected:.0f} pixels lie at the height of a block"
    plane = _level_plane(points[candidate])
    if plane is None:
        return "the pixels at the height of a block form no plane"
    a, b, c = plane
    tilt = float(np.arctan(np.hypot(a, b)))
    if tilt > max_tilt_rad:
        return f"the surface is tilted by {shown(tilt, 'rad', '.0f')}"

    # Where each ray meets the plane of the outline, whether or not it ends there; rays that hit the peg, or that belong
    # to a neighbouring peg, carry no information.
    above = points[..., 2] - (a * points[..., 0] + b * points[..., 1] + c)
    middle = c - STEP_DOWN_M / 2
    reach = (middle + a * eye[0] + b * eye[1] - eye[2]) / (rays[..., 2] - a * rays[..., 0] - b * rays[..., 1])
    xy = (eye + rays * reach[..., None])[..., :2]
    known = np.hypot(xy[..., 0], xy[..., 1]) < WINDOW_M
    known &= _nearest_here(xy, others_m) & ~((radius < PEG_GUARD_M) & (above > -block.height_m / 2))
    on = known & candidate & (above > -STEP_DOWN_M) & (above < STEP_UP_M)
    through = known & (above < -STEP_DOWN_M)
    count = int(on.sum())
    if count < min_count:
        return f"only {count} of {expected:.0f} pixels lie on a top face"
    pose, missed, bare = fit_outline(face, xy[on], xy[through])
    mismatch, visible = (missed + bare) / count, (1 - missed / count) * count / expected
    if not (mismatch < MAX_MISMATCH and visible > MIN_VISIBLE):
        return f"the outline fits badly: {mismatch:.0%} of the pixels contradict it, {visible:.0%} is visible"
    x, y, yaw = (float(value) for value in pose)
    turn = SO3.between([0.0, 0.0, 1.0], [-a, -b, 1.0]) @ SO3.axis("z", yaw % np.radians(120.0))
    return SE3.from_parts(turn @ SO3(np.diag([1.0, -1.0, -1.0])), [x, y, a * x + b * y + c])


def _level_plane(points: Array) -> tuple[float, float, float] | None:
    """Return a, b, c of z = a x + b y + c through most of the points (n, 3), or None if too few agree.

    Starts at the most frequent height and refits with shrinking gates, so that walls and neighbours drop out.
    """
    a = b = 0.0
    counts, edges = np.histogram(points[:, 2], bins=np.arange(-3e-3, 3.01e-3, 0.5e-3))
    c = float(edges[int(np.argmax(counts[:-1] + counts[1:])) + 1])
    for gate in (1.2e-3, 0.9e-3, 0.6e-3, 0.6e-3):
        residual = points[:, 2] - (a * points[:, 0] + b * points[:, 1] + c)
        near = points[np.abs(residual) < gate]
        if len(near) < MIN_POINTS / 2:
            return None
        middle = near[:, :2].mean(0)
        A = np.column_stack([near[:, :2] - middle, np.ones(len(near))])
        a, b, height = np.linalg.lstsq(A, near[:, 2], rcond=None)[0]
        c = height - a * middle[0] - b * middle[1]
    return float(a), float(b), float(c)


def _nearest_here(xy: Array, others_m: Array) -> NDArray[np.bool_]:
    """Return which points are nearer to this peg (the origin) than to any other."""
    here = np.sum(xy**2, -1)
    keep = np.ones(here.shape, dtype=bool)
    for other in others_m[np.linalg.norm(others_m, axis=-1) < 3 * WINDOW_M]:
        keep &= ~(np.sum((xy - other) ** 2, -1) < here)
    return keep


def _pixel_area(rays: Array, eye: Array) -> float:
    """Return the area that a pixel in the middle of the window covers on the plane z = 0."""
    i, j = rays.shape[0] // 2, rays.shape[1] // 2
    at = [eye[:2] - eye[2] * r[:2] / r[2] for r in (rays[i, j], rays[i - 1, j], rays[i, j - 1])]
    (ax, ay), (bx, by) = at[1] - at[0], at[2] - at[0]
    return abs(float(ax * by - ay * bx))


@dataclass(frozen=True, eq=False)
class TopFace:
    """Signed distance to the outline of the top face in the block frame's x, y: positive on the face.

    Attributes:
        distance_m: (n, n) distance at the nodes ``-MAP_M + k NODE_M``, indexed [x, y].
        gradient: (n, n, 2) its gradient with respect to x, y.
        area_m2: area of the face.
    """

    distance_m: Array
    gradient: Array
    area_m2: float

    def at(self, xy_m: Array) -> tuple[Array, Array]:
        """Return the distance (...) at points (..., 2), bilinear between nodes, and the nearest node's gradient."""
        at = np.clip((xy_m + MAP_M) / NODE_M, 0, len(self.distance_m) - 1.001)
        (i, j), d = np.moveaxis(at.astype(np.intp), -1, 0), self.distance_m
        a, b = at[..., 0] - i, at[..., 1] - j
        low, high = (1 - b) * d[i, j] + b * d[i, j + 1], (1 - b) * d[i + 1, j] + b * d[i + 1, j + 1]
        return (1 - a) * low + a * high, self.gradient[i + (a > 0.5), j + (b > 0.5)]

    def nearest(self, xy_m: Array) -> Array:
        """Return the distance (...) at the nodes nearest to points (..., 2), which is coarse but fast."""
        at = np.clip(np.rint((xy_m + MAP_M) / NODE_M), 0, len(self.distance_m) - 1).astype(np.intp)
        return self.distance_m[at[..., 0], at[..., 1]]

    def of(self, xy_m: Array, pose: Array) -> tuple[Array, Array]:
        """Return the distance (n,) at points (n, 2) if the face is at x, y, yaw (3,), and its Jacobian (n, 3)."""
        local, cosine, sine = in_block(xy_m, *pose)
        distance, slope = self.at(local)
        dx = -slope[:, 0] * cosine - slope[:, 1] * sine
        dy = -slope[:, 0] * sine + slope[:, 1] * cosine
        dyaw = -slope[:, 0] * local[:, 1] + slope[:, 1] * local[:, 0]
        return distance, np.stack([dx, dy, dyaw], -1)


@lru_cache(maxsize=8)
def top_face(block: Block) -> TopFace:
    """Return the map of this block's top face."""
    angle = np.linspace(0, TURN, 720, endpoint=False)
    radius = np.concatenate([block.hole_radius_m(angle), block.outer_radius_m(angle)])
    both = np.concatenate([angle, angle])
    outline = KDTree(np.column_stack([radius * np.cos(both), radius * np.sin(both)]))
    ticks = np.arange(round(2 * MAP_M / NODE_M) + 1) * NODE_M - MAP_M
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    r, a = np.hypot(x, y), np.arctan2(y, x)
    inside = (r >= block.hole_radius_m(a)) & (r <= block.outer_radius_m(a))
    distance = outline.query(np.stack([x, y], -1))[0] * np.where(inside, 1.0, -1.0)
    gradient = np.stack(np.gradient(distance, NODE_M), -1)
    return TopFace(distance, gradient, float(inside.sum()) * NODE_M**2)


def in_block(xy_m: Array, x_m: Array, y_m: Array, yaw_rad: Array) -> tuple[Array, Array, Array]:
    """Return points (n, 2) of a plane in the x, y of a block, and cosine and sine of the block's yaw.

    The plane's z points towards the viewer, the block's z away from the viewer. Poses broadcast with the points.
    """
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    dx, dy = xy_m[..., 0] - x_m, xy_m[..., 1] - y_m
    return np.stack([cosine * dx + sine * dy, sine * dx - cosine * dy], -1), cosine, sine


def fit_outline(face: TopFace, shows_m: Array, bare_m: Array) -> tuple[Array, int, int]:
    """Return x, y, yaw (3,) that minimise sum (shows_face - s(d / w))^2, d = signed distance inside the outline.

    Here s is the logistic function and w is ``SOFTNESS_M``. The second and third results are the numbers of pixels that
    contradict the outline: those that show the face outside it, and bare ones inside it.

    Args:
        face: the outline.
        shows_m: (n, 2) where rays that end on the face meet its plane, z towards the viewer.
        bare_m: (m, 2) where rays that pass through the plane meet it.
    """
    xy = np.concatenate([shows_m, bare_m])
    label = (np.arange(len(xy)) < len(shows_m)).astype(np.float64)
    every = max(1, len(xy) // COARSE_PIXELS)
    sign = 2 * label[::every] - 1
    starts = coarse_poses(
        face, xy[::every], shows_m.mean(0), lambda distance: np.sum(sign * np.clip(distance, -5e-4, 5e-4), -1)
    )

    def residual(pose: Array) -> tuple[Array, Array]:
        distance, jacobian = face.of(xy, pose)
        soft = 1 / (1 + np.exp(-np.clip(distance / SOFTNESS_M, -30, 30)))
        return soft - label, (soft * (1 - soft) / SOFTNESS_M)[:, None] * jacobian

    pose, _ = min(map(partial(refined, residual), starts), key=lambda end: end[1])
    distance, _ = face.of(xy, pose)
    missed = int((distance[: len(shows_m)] < -CONTRADICTION_M).sum())
    return pose, missed, int((distance[len(shows_m) :] > CONTRADICTION_M).sum())


def coarse_poses(face: TopFace, xy_m: Array, centre_m: Array, score: Callable[[Array], Array]) -> list[Array]:
    """Return the best distinct poses (3,) of a grid over all yaws and offsets from a centre (2,).

    ``score`` turns signed distances (yaws, offsets, n) of points (n, 2) into scores (yaws, offsets); higher is better.
    """
    ticks = np.arange(-OFFSET_REACH_M, OFFSET_REACH_M + OFFSET_STEP_M / 2, OFFSET_STEP_M)
    offsets = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)
    x, y = offsets.T[:, None, :, None]
    local, *_ = in_block((xy_m - centre_m)[None, None], x, y, YAWS_RAD[:, None, None])
    scores = score(face.nearest(local))
    starts: list[Array] = []
    for flat in np.argsort(scores, axis=None)[::-1][:200]:
        yaw, offset = np.unravel_index(flat, scores.shape)
        start = np.array([*(centre_m + offsets[offset]), YAWS_RAD[yaw]])
        if all(_apart(start, other) for other in starts):
            starts.append(start)
        if len(starts) == FINALISTS:
            break
    return starts


def _apart(a: Array, b: Array) -> bool:
    turn = np.radians(120.0)
    yaw = abs((a[2] - b[2] + turn / 2) % turn - turn / 2)
    return bool(yaw > np.radians(12.0) or np.hypot(*(a[:2] - b[:2])) > 2e-3)


def refined(residual: Callable[[Array], tuple[Array, Array]], start: Array) -> tuple[Array, float]:
    """Return the pose (3,) refined by Levenberg-Marquardt, and its mean square residual.

    ``residual`` returns the residuals (n,) at a pose and their Jacobian (n, 3).
    """
    pose, damping = start, 1e-3
    off, jacobian = residual(pose)
    loss = float(off @ off)
    for _ in range(REFINEMENTS):
        hessian = jacobian.T @ jacobian
        scale = np.diag(np.diag(hessian) + 1e-9)
        step = np.linalg.solve(hessian + damping * scale, -jacobian.T @ off)
        trial = pose + step
        trial_off, trial_jacobian = residual(trial)
        trial_loss = float(trial_off @ trial_off)
        if trial_loss < loss:
            pose, off, jacobian, loss, damping = trial, trial_off, trial_jacobian, trial_loss, damping / 5
        else:
            damping *= 8
        if np.hypot(*step[:2]) < 2e-6 and abs(step[2]) < 2e-4:
            break
    return pose, loss / len(off)
