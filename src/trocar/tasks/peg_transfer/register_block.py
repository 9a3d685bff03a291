"""``trocar register block``: the pose of a block in a depth capture."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from trocar.cli.group import Known, Result

app = Known(
    "Find the block whose top face a depth camera captured; exit code 1 if there is none.",
    f"{__name__}:block",
    "trocar register block capture.npz --unit mm --json",
)


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
    from trocar.tasks.peg_transfer.perception.cloud import fit_cloud
    from trocar.tasks.peg_transfer.perception.outline import top_face
    from trocar.tasks.peg_transfer.shapes import Block

    points = load_capture(capture, unit)
    model = Block()
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
