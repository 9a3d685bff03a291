"""``trocar register block``: the pose of a block in an unordered cloud of points on its top face."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typer import Argument, Option

from trocar.cli.group import Known, Result
from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.shapes import Block

MIN_POINTS = 60
PLANE_GATES_M = (4e-3, 2.5e-3, 1.5e-3)
PLANE_STEPS = 3
COARSE_POINTS = 150
MAX_RMS_M = 1.0e-3
MIN_COVERED = 0.4
COVER_M = 0.7e-3

app = Known(
    "Find the block whose top face a depth camera captured; exit code 1 if there is none.",
    f"{__name__}:block",
    "trocar register block capture.npz --unit mm --json",
)


@dataclass(frozen=True, eq=False)
class CloudFit:
    """Result of ``fit_cloud``."""

    found: bool  # whether the cloud shows a block's top face
    reason: str  # one sentence: why not, or that it does
    # pose in the cloud's frame, with one of three equivalent yaws; None if no fit was possible
    T_capture_block: SE3 | None
    rms_m: float  # root mean square distance of the points on the plane from the face
    inliers: int  # number of points on the plane
    covered: float  # share of the face that is near points


def block(
    capture: Annotated[
        Path,
        Argument(
            metavar="CAPTURE",
            help="Points (n, 3) on one top face, seen from their origin: .npz with points_mm or points_m, or .npy.",
        ),
    ],
    *,
    unit: Annotated[str | None, Option(help="mm or m; needed where the array's name does not say it.")] = None,
) -> Result:
    """Find the block whose top face a depth camera captured; exit code 1 if there is none.

    The block frame lies in the middle of the top face, z into the block; yaw is one of three equal ones.
    """
    from trocar.perception.capture import load_capture  # SciPy only when needed
    from trocar.tasks.peg_transfer.perception.blocks import top_face

    points, model = load_capture(capture, unit), Block()
    top_face(model)  # the model's map is made once for any number of captures
    start = time.perf_counter()
    fit = fit_cloud(points, model)
    compute_ms = 1e3 * (time.perf_counter() - start)
    pose = None if fit.T_capture_block is None else fit.T_capture_block.matrix
    summary = {
        "found": fit.found,
        "reason": fit.reason,
        "T_capture_block": None if pose is None else pose.tolist(),
        "rms_m": fit.rms_m if np.isfinite(fit.rms_m) else None,
        "points": len(points),
        "inliers": fit.inliers,
        "covered": fit.covered,
        "compute_ms": compute_ms,
    }
    lines = [f"block: {fit.reason}"]
    if pose is not None:
        lines += [
            f"T_capture_block (m):\n{np.array2string(pose, precision=6, suppress_small=True)}",
            f"rms {fit.rms_m * 1e3:.2f} mm, {fit.inliers} of {len(points)} points on the face, "
            f"{fit.covered:.0%} of it covered; {compute_ms:.1f} ms",
        ]
    return Result(summary, lines, succeeded=fit.found)


def fit_cloud(points_m: ArrayLike, block: Block) -> CloudFit:
    """Return the block's pose from points (n, 3) in m, seen from their frame's origin.

    A plane is fitted with shrinking gates; in the plane, the distance of the points from the face is minimised. This is
    the result to which point-to-point ICP on a dense model converges. The search starts from all yaws and many offsets.

    Raises:
        InvalidInput: the shape is wrong, there are fewer than 60 points, or points are not finite.
    """
    from trocar.tasks.peg_transfer.perception.blocks import coarse_poses, in_block, refined, top_face

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
    face, xy = top_face(block), local[:, :2]

    def residual(pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        distance, jacobian = face.of(xy, pose)
        return np.maximum(-distance, 0.0), -jacobian * (distance < 0)[:, None]

    starts = coarse_poses(
        face,
        xy[:: max(1, len(xy) // COARSE_POINTS)],
        (xy.max(0) + xy.min(0)) / 2,
        lambda distance: -np.mean(np.minimum(distance, 0.0) ** 2, -1),
    )
    pose, _ = min((refined(residual, start) for start in starts), key=lambda end: end[1])
    outside, _ = residual(pose)
    rms = float(np.sqrt(np.mean(outside**2 + local[:, 2] ** 2)))
    # The share of the face's area that has points nearby, counted on a square grid.
    on_face, model = in_block(xy, *pose)[0], block.top_face_m(0.3e-3)[:, :2]
    cells, wanted = ({tuple(cell) for cell in np.floor(p / (2 * COVER_M)).astype(int)} for p in (on_face, model))
    covered = len(cells & wanted) / len(wanted)
    turn = SO3.axis("z", pose[2]) @ SO3(np.diag([1.0, -1.0, -1.0]))
    T_capture_block = T_capture_face @ SE3.from_parts(turn, [pose[0], pose[1], 0.0])
    found = rms < MAX_RMS_M and covered > MIN_COVERED
    reason = "found" if found else f"rms {rms * 1e3:.2f} mm, {covered:.0%} of the face covered: not a block's top face"
    return CloudFit(found, reason, T_capture_block, rms, int(near.sum()), covered)


def _face_plane(points: NDArray[np.float64]) -> tuple[SE3, NDArray[np.bool_]]:
    """Return a frame on the face, z towards the viewer, and which points lie on the face."""
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
    z = -normal if normal @ middle >= 0 else normal
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3.unchecked(np.column_stack([x, np.cross(z, x), z])), middle), near
