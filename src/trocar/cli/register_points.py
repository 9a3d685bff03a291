"""``trocar register points``: the pose of a camera in a robot's base from paired points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.files.reading import read_arrays
from trocar.geometry import fit_rigid


def points(
    robot: Annotated[Path, typer.Argument(metavar="ROBOT.npy", help="(n, 3) points in the robot's base, m.")],
    camera: Annotated[Path, typer.Argument(metavar="CAMERA.npy", help="(n, 3) same points in the camera, m.")],
    *,
    inlier_mm: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Leave out pairs farther apart than this (RANSAC). Default: keep all."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random draws of --inlier-mm.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Fit the camera's pose in the robot's base to paired points by least squares."""
    if seed < 0:
        raise TrocarError(f"seed {seed} is negative; give 0 or more")
    if inlier_mm is not None and not inlier_mm > 0:
        raise TrocarError(f"--inlier-mm is {inlier_mm}; give a distance above 0 mm")
    p_robot, p_camera = _load(robot), _load(camera)
    if p_robot.shape != p_camera.shape:
        raise TrocarError(
            f"{str(robot)!r} has shape {p_robot.shape} and {str(camera)!r} {p_camera.shape}; "
            "give the same n points (n, 3) in both, in the same order"
        )
    fit = fit_rigid(
        p_camera,
        p_robot,
        inlier_distance_m=None if inlier_mm is None else inlier_mm / 1000,
        rng=np.random.default_rng(seed),
    )
    result = {
        "T_robot_camera": fit.T_target_source.matrix.tolist(),
        "rms_m": fit.rms_m,
        "inliers": int(fit.inliers.sum()),
        "points": len(fit.inliers),
    }
    if as_json:
        typer.echo(json.dumps(result))
        return
    typer.echo(f"camera in the robot's base, from {result['inliers']} of {result['points']} points:")
    for row in fit.T_target_source.matrix:
        typer.echo("  " + " ".join(f"{value:12.8f}" for value in row))
    typer.echo(f"rms distance {1000 * fit.rms_m:.3f} mm")


def _load(path: Path) -> NDArray[np.float64]:
    """Return the array of numbers in a .npy file."""
    if path.is_dir():
        raise TrocarError(f"{str(path)!r} is a folder; give a .npy file of (n, 3) points in m")
    if not path.is_file():
        raise TrocarError(f"file {str(path)!r} does not exist; give a .npy file of (n, 3) points in m")
    try:
        points = read_arrays(path)[""].astype(np.float64, casting="safe")
    except (ValueError, OSError, TypeError, KeyError):
        raise TrocarError(
            f"file {str(path)!r} is not a readable .npy array; save (n, 3) points in m with numpy.save"
        ) from None
    bad = np.flatnonzero(~np.isfinite(points).all(axis=tuple(range(1, points.ndim)))) if points.ndim else []
    if len(bad):
        raise TrocarError(
            f"file {str(path)!r} holds NaN or infinity, first in row {bad[0]}; remove such rows from both files"
        )
    return points
