"""Pose of the block on a peg, from one colour and depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry import SE3, SO3, shown
from trocar.perception.color import red_mask
from trocar.perception.depth import Patch, patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.perception.outline import fit_outline, top_face
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
MAX_TILT_RAD = np.radians(8.0)
MIN_POINTS = 40


@dataclass(frozen=True, eq=False)
class BlockFit:
    """Result of ``find_block``.

    Attributes:
        found: whether a block hangs on the peg.
        reason: one sentence: why not, or that it was found.
        T_board_block: pose in the board frame, with one of three equivalent yaws; None if not found.
        rms_m: root mean square distance of the top face's pixels from their plane.
        inliers: number of pixels on the top face.
        visible: share of the top face that these pixels cover.
        mismatch: share of the pixels that contradict the outline.
        tilt_rad: tilt of the top face relative to the board.
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
        """Return the angle of the block's x axis about the board's z, in [0, 120 deg) because of the symmetry."""
        if self.T_board_block is None:
            raise InvalidInput("a fit without a block", "has no yaw", self.reason)
        x = self.T_board_block.matrix[:3, 0]
        return float(np.arctan2(x[1], x[0]) % np.radians(120.0))


def find_block(image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block, peg: int) -> BlockFit:
    """Return the pose of the block that hangs on a peg and stands on the plate, or the reason why none was found.

    A plane is fitted to the red pixels at the height of the top face. Each pixel's ray then either ends on this plane
    (and shows the face) or passes through it (and shows that there is none). The outline's x, y and yaw are fitted to
    both kinds of pixels; pixels that end above the plane (peg, tool) or have no depth carry no information.

    Args:
        image: colour and depth.
        T_camera_board: pose of the board, as refined by ``find_board``.
        board: gives the pegs.
        block: gives height and outline.
        peg: 0-11.

    Raises:
        InvalidValue: the peg does not exist.
    """
    pegs = board.pegs_m
    if not 0 <= peg < len(pegs):
        raise InvalidValue("the peg's number", peg, f"the board has pegs 0 to {len(pegs) - 1}")
    foot = pegs[peg]
    others = np.delete(pegs, peg, 0)[:, :2] - foot[:2]
    return _fit_around(image, T_camera_board, foot + [0, 0, block.height_m], block, others, f"peg {peg}")


def find_blocks(image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block) -> list[BlockFit]:
    """Return the result of ``find_block`` for each peg, in order."""
    return [find_block(image, T_camera_board, board, block, peg) for peg in range(len(board.pegs_m))]


def find_held_block(image: RgbdImage, T_camera_board: SE3, block: Block, T_board_expected: SE3) -> BlockFit:
    """Return the pose of a block in the jaws of an arm, upright or nearly so, or the reason why none was found.

    Like ``find_block``, where no peg is in the way. What the jaws hide carries no information.

    Args:
        image: colour and depth.
        T_camera_board: pose of the board, as refined by ``find_board``.
        block: gives height and outline.
        T_board_expected: where the arm's joints have it; to be found, it must be there within some millimetres.
    """
    at = T_board_expected.translation_m
    return _fit_around(image, T_camera_board, at, block, np.zeros((0, 2)), "the block in the jaws")


def _fit_around(
    image: RgbdImage, T_camera_board: SE3, top_m: NDArray[np.float64], block: Block, others_m: NDArray, what: str
) -> BlockFit:
    """Return the fit in the board's frame of the block whose top face is near a point (3,) of it."""
    T_board_top = SE3.from_parts(translation_m=top_m)
    half = np.array([WINDOW_M, WINDOW_M, 1e-3])
    patch = patch_around(image, T_camera_board @ T_board_top, -half, half)
    if patch is None:
        return BlockFit(False, f"{what} lies outside the image")
    fit = _fit_in_window(patch, T_camera_board @ T_board_top, block, others_m)
    found = fit.T_board_block
    return fit if found is None else replace(fit, T_board_block=T_board_top @ found if fit.found else None)


def _fit_in_window(patch: Patch, T_camera_top: SE3, block: Block, others_m: NDArray[np.float64]) -> BlockFit:
    """Return the fit in the frame of the top face of a block that is centred on the peg."""
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
    min_count = max(MIN_POINTS, MIN_VISIBLE * expected)
    count = int(candidate.sum())
    if count < min_count:
        return BlockFit(False, f"only {count} of {expected:.0f} pixels lie at the height of a block", inliers=count)
    plane = fit_level_plane(points[candidate])
    if plane is None:
        return BlockFit(False, "the pixels at the height of a block form no plane", inliers=count)
    a, b, c = plane
    tilt = float(np.arctan(np.hypot(a, b)))
    if tilt > MAX_TILT_RAD:
        return BlockFit(False, f"the surface is tilted by {shown(tilt, 'rad', '.0f')}", inliers=count, tilt_rad=tilt)

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
        return BlockFit(False, f"only {count} of {expected:.0f} pixels lie on a top face", inliers=count)
    outline = fit_outline(face, np.concatenate([xy[on], xy[through]]), np.arange(count + through.sum()) < count)
    visible = outline.covered * count / expected
    rms = float(np.sqrt(np.mean(above[on] ** 2)))
    found = outline.mismatch < MAX_MISMATCH and visible > MIN_VISIBLE
    reason = (
        "found"
        if found
        else f"the outline fits badly: {outline.mismatch:.0%} of the pixels contradict it, {visible:.0%} is visible"
    )
    yaw, x, y = outline.yaw_rad, outline.x_m, outline.y_m
    pose = SE3.from_parts(
        SO3.between([0.0, 0.0, 1.0], [-a, -b, 1.0]) @ SO3.axis("z", yaw) @ SO3(np.diag([1.0, -1.0, -1.0])),
        [x, y, a * x + b * y + c],
    )
    return BlockFit(found, reason, pose, rms, count, float(visible), outline.mismatch, tilt)


def fit_level_plane(points: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Return a, b, c of z = a x + b y + c through most of the points (n, 3), or None if too few agree.

    Starts at the most frequent height and refits with shrinking gates, so that walls and neighbours drop out.
    """
    a = b = 0.0
    counts, edges = np.histogram(points[:, 2], bins=np.arange(-3e-3, 3.01e-3, 0.5e-3))
    smooth = counts[:-1] + counts[1:]
    c = float(edges[int(np.argmax(smooth)) + 1])
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


def _nearest_here(xy: NDArray[np.float64], others_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are nearer to this peg (the origin) than to any other."""
    here = np.sum(xy**2, -1)
    near = others_m[np.linalg.norm(others_m, axis=-1) < 3 * WINDOW_M]
    keep = np.ones(here.shape, dtype=bool)
    for other in near:
        keep &= ~(np.sum((xy - other) ** 2, -1) < here)
    return keep


def _pixel_area(rays: NDArray[np.float64], eye: NDArray[np.float64]) -> float:
    """Return the area that a pixel in the middle of the window covers on the plane z = 0."""
    i, j = rays.shape[0] // 2, rays.shape[1] // 2
    at = [eye[:2] - eye[2] * r[:2] / r[2] for r in (rays[i, j], rays[i - 1, j], rays[i, j - 1])]
    (ax, ay), (bx, by) = at[1] - at[0], at[2] - at[0]
    return abs(float(ax * by - ay * bx))
