"""Pose of the block on a peg, from one colour and depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.color import red_mask
from trocar.perception.depth import Patch, check_image, patch_around
from trocar.perception.image import RgbdImage
from trocar.perception.outline import fit_outline
from trocar.perception.top_face import top_face
from trocar.scene import Block, Pegboard

WINDOW_M = 13e-3
"""Half of the window round the peg: outline 8.95 mm, clearance 3.2 mm, a pixel."""

PEG_GUARD_M = 2.4e-3
"""Surfaces this near to the peg's axis are the peg (the authors' ring begins at 2.5 mm)."""

HEIGHT_WINDOW_M = 2.5e-3
STEP_DOWN_M = 0.6e-3
"""A surface this far under the top plane is not the top: three SD of depth noise, and a wall counts half of it."""

STEP_UP_M = 1.0e-3
LEAST_VISIBLE = 0.30
MOST_MISMATCH = 0.22
MOST_TILT_RAD = np.radians(8.0)
LEAST_POINTS = 40


@dataclass(frozen=True, eq=False)
class BlockFit:
    """What was found where a block was looked for.

    Attributes:
        found: whether a block stands there.
        reason: one sentence: why not, or that it was found.
        T_board_block: pose in the board frame; yaw is one of three equal ones. None if not found.
        rms_m: residual of the top face to its plane.
        inliers: pixels on the top face.
        visible: share of the top face that these pixels cover.
        mismatch: share of the pixels that contradict the outline.
        tilt_rad: top face against the board.
    """

    found: bool
    reason: str
    T_board_block: SE3 | None = None
    rms_m: float = float("nan")
    inliers: int = 0
    visible: float = 0.0
    mismatch: float = 1.0
    tilt_rad: float = float("nan")

    @property
    def yaw_rad(self) -> float:
        """Return the angle of the block's x axis about the board's z in [0, 120 deg): the rest is symmetry."""
        if self.T_board_block is None:
            raise TrocarError(f"there is no yaw without a block: {self.reason}")
        x = self.T_board_block.matrix[:3, 0]
        return float(np.arctan2(x[1], x[0]) % np.radians(120.0))


def find_block(image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block, peg: int) -> BlockFit:
    """Return the pose of the block that hangs on a peg and stands on the plate, or why there is none.

    The top plane is fitted to the red pixels at its height; then each pixel's ray meets that plane and either stops
    there (it shows the face) or passes through it (it shows that no face is there). The outline's x, y and yaw are
    fitted to both kinds; pixels that stop before the plane (peg, tool) or have no depth say nothing.

    Args:
        image: colour and depth.
        T_camera_board: pose of the board, as ``find_board`` refined it.
        board: for the pegs.
        block: for height and outline.
        peg: 0-11.

    Raises:
        TrocarError: for a peg that does not exist, or an image that does not fit its intrinsics.
    """
    check_image(image)
    pegs = board.pegs_m
    if not 0 <= peg < len(pegs):
        raise TrocarError(f"peg {peg} does not exist: the board has pegs 0 to {len(pegs) - 1}")
    foot = pegs[peg]
    T_camera_top = T_camera_board @ SE3.from_parts(translation_m=foot + [0, 0, block.height_m])
    half = np.array([WINDOW_M, WINDOW_M, 1e-3])
    patch = patch_around(image, T_camera_top, -half, half)
    if patch is None:
        return BlockFit(False, f"peg {peg} lies outside the image")
    others = np.delete(pegs, peg, 0)[:, :2] - foot[:2]
    fit = _fit_in_window(patch, T_camera_top, block, others)
    if fit.T_board_block is None:
        return fit
    T_board_top = SE3.from_parts(translation_m=foot + [0, 0, block.height_m])
    return BlockFit(
        fit.found,
        fit.reason,
        T_board_top @ fit.T_board_block if fit.found else None,
        fit.rms_m,
        fit.inliers,
        fit.visible,
        fit.mismatch,
        fit.tilt_rad,
    )


def find_blocks(image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block) -> list[BlockFit]:
    """Return what stands on each of the pegs, in their order."""
    return [find_block(image, T_camera_board, board, block, peg) for peg in range(len(board.pegs_m))]


def _fit_in_window(patch: Patch, T_camera_top: SE3, block: Block, others_m: NDArray[np.float64]) -> BlockFit:
    """Fit the block in a frame whose origin is where its top face stands if it is centred on the peg."""
    T_top_camera = T_camera_top.inverse()
    rays = patch.rays @ T_top_camera.rotation.matrix.T
    eye = T_top_camera.translation_m
    points = eye + rays * patch.depth_m[..., None]
    radius = np.hypot(points[..., 0], points[..., 1])
    own = _nearest_here(points[..., :2], others_m)
    candidate = (
        (np.abs(points[..., 2]) < HEIGHT_WINDOW_M)
        & (radius > PEG_GUARD_M)
        & (radius < WINDOW_M)
        & own
        & red_mask(patch.color)
    )
    face = top_face(block)
    per_pixel = _pixel_area(rays, eye)
    expected = face.area_m2 / per_pixel
    least = max(LEAST_POINTS, LEAST_VISIBLE * expected)
    count = int(candidate.sum())
    if count < least:
        return BlockFit(False, f"only {count} of {expected:.0f} pixels lie at the height of a block", inliers=count)
    plane = fit_level_plane(points[candidate])
    if plane is None:
        return BlockFit(False, "the pixels at the height of a block form no plane", inliers=count)
    a, b, c = plane
    tilt = float(np.arctan(np.hypot(a, b)))
    if tilt > MOST_TILT_RAD:
        return BlockFit(False, f"what is there is tilted by {np.degrees(tilt):.0f} deg", inliers=count, tilt_rad=tilt)

    above = points[..., 2] - (a * points[..., 0] + b * points[..., 1] + c)
    middle = c - STEP_DOWN_M / 2
    reach = (middle + a * eye[0] + b * eye[1] - eye[2]) / (rays[..., 2] - a * rays[..., 0] - b * rays[..., 1])
    xy = (eye + rays * reach[..., None])[..., :2]
    known = np.hypot(xy[..., 0], xy[..., 1]) < WINDOW_M
    known &= _nearest_here(xy, others_m) & ~((radius < PEG_GUARD_M) & (above > -block.height_m / 2))
    on = known & candidate & (above > -STEP_DOWN_M) & (above < STEP_UP_M)
    through = known & (above < -STEP_DOWN_M)
    count = int(on.sum())
    if count < least:
        return BlockFit(False, f"only {count} of {expected:.0f} pixels lie on a top face", inliers=count)
    outline = fit_outline(face, np.concatenate([xy[on], xy[through]]), np.arange(count + through.sum()) < count)
    visible = outline.covered * count / expected
    rms = float(np.sqrt(np.mean(above[on] ** 2)))
    found = outline.mismatch < MOST_MISMATCH and visible > LEAST_VISIBLE
    reason = (
        "found"
        if found
        else f"the outline fits badly: {outline.mismatch:.0%} of the pixels contradict it, {visible:.0%} is visible"
    )
    yaw, x, y = outline.yaw_rad, outline.x_m, outline.y_m
    pose = SE3.from_parts(
        _upright(a, b) @ SO3.axis("z", yaw) @ SO3(np.diag([1.0, -1.0, -1.0])), [x, y, a * x + b * y + c]
    )
    return BlockFit(found, reason, pose, rms, count, float(visible), outline.mismatch, tilt)


def fit_level_plane(points: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Return a, b, c of z = a x + b y + c through most of the points (n, 3), by shrinking gates; None if few agree."""
    a = b = 0.0
    counts, edges = np.histogram(points[:, 2], bins=np.arange(-3e-3, 3.01e-3, 0.5e-3))
    smooth = counts[:-1] + counts[1:]
    c = float(edges[int(np.argmax(smooth)) + 1])
    for gate in (1.2e-3, 0.9e-3, 0.6e-3, 0.6e-3):
        residual = points[:, 2] - (a * points[:, 0] + b * points[:, 1] + c)
        near = points[np.abs(residual) < gate]
        if len(near) < LEAST_POINTS / 2:
            return None
        middle = near[:, :2].mean(0)
        A = np.column_stack([near[:, :2] - middle, np.ones(len(near))])
        a, b, height = np.linalg.lstsq(A, near[:, 2], rcond=None)[0]
        c = height - a * middle[0] - b * middle[1]
    return float(a), float(b), float(c)


def _upright(a: float, b: float) -> SO3:
    """Return the smallest rotation that takes z to the normal of z = a x + b y."""
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    axis = np.cross([0.0, 0.0, 1.0], normal)
    sine = np.linalg.norm(axis)
    return SO3.exp(axis * (np.arcsin(sine) / sine if sine > 1e-12 else 1.0))


def _nearest_here(xy: NDArray[np.float64], others_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are nearer to this peg (the origin) than to any other."""
    here = np.sum(xy**2, -1)
    near = others_m[np.linalg.norm(others_m, axis=-1) < 3 * WINDOW_M]
    keep = np.ones(here.shape, dtype=bool)
    for other in near:
        keep &= ~(np.sum((xy - other) ** 2, -1) < here)
    return keep


def _pixel_area(rays: NDArray[np.float64], eye: NDArray[np.float64]) -> float:
    """Return the area that one pixel covers on the plane z = 0, in the middle of the window."""
    i, j = rays.shape[0] // 2, rays.shape[1] // 2
    at = [eye[:2] - eye[2] * r[:2] / r[2] for r in (rays[i, j], rays[i - 1, j], rays[i, j - 1])]
    (ax, ay), (bx, by) = at[1] - at[0], at[2] - at[0]
    return abs(float(ax * by - ay * bx))
