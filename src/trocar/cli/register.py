"""``trocar register``: poses from paired points, and a whole cell's from images of a checkerboard."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from typer import Argument, Option

from trocar.cli.group import Result
from trocar.cli.options import Seed, StationName, need
from trocar.cli.out_folder import check_out_folder
from trocar.cli.progress import progress
from trocar.errors import BadFile, InvalidInput, InvalidValue
from trocar.files.output import PICTURE, make_folder, write_json, write_text
from trocar.files.reading import read_numbers
from trocar.geometry import fit_rigid

STATION, REPORT = "station", "report of a registration"
FILES = {"station.toml": STATION, "report.json": REPORT, "corners.png": PICTURE}
"""The files of a cell's registration, with their kinds."""


def points(
    robot: Annotated[Path, Argument(metavar="ROBOT.npy", help="(n, 3) points in the robot's base, m.")],
    camera: Annotated[Path, Argument(metavar="CAMERA.npy", help="(n, 3) same points in the camera, m.")],
    *,
    inlier_mm: Annotated[
        float | None, Option(metavar="MM", help="Leave out pairs farther apart than this (RANSAC). Default: keep all.")
    ] = None,
    seed: Seed = 0,
) -> Result:
    """Fit the camera's pose in the robot's base to paired points by least squares."""
    if inlier_mm is not None and not inlier_mm > 0:
        raise InvalidValue("--inlier-mm", inlier_mm, "give a distance above 0 mm")
    p_robot, p_camera = _points(robot), _points(camera)
    if p_robot.shape != p_camera.shape:
        problem = f"has shape {p_robot.shape} and {camera} {p_camera.shape}"
        raise InvalidInput(str(robot), problem, "give the same n points (n, 3) in both, in the same order")
    inlier_m = None if inlier_mm is None else inlier_mm / 1000
    fit = fit_rigid(p_camera, p_robot, inlier_distance_m=inlier_m, rng=np.random.default_rng(seed))
    pose, inliers = fit.T_target_source.matrix, int(fit.inliers.sum())
    return Result(
        {"T_robot_camera": pose.tolist(), "rms_m": fit.rms_m, "inliers": inliers, "points": len(fit.inliers)},
        [
            f"camera in the robot's base, from {inliers} of {len(fit.inliers)} points:",
            *("  " + " ".join(f"{value:12.8f}" for value in row) for row in pose),
            f"rms distance {1000 * fit.rms_m:.3f} mm",
        ],
    )


def _points(path: Path) -> NDArray[np.float64]:
    found = read_numbers(path, "(n, 3) points in m")
    bad = np.flatnonzero(~np.isfinite(found).all(axis=tuple(range(1, found.ndim)))) if found.ndim else []
    if len(bad):
        problem = f"holds NaN or infinity, first in row {bad[0]}"
        raise BadFile(path, problem, "remove such rows from both files", kind="file")
    return found


def cell(
    station: StationName,
    *,
    seed: Seed = 0,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for the files; default out/registration-STATION-SEED.")
    ] = None,
) -> Result:
    """Register a simulated cell with a checkerboard: lenses, camera and bases; print errors against the truth."""
    need("sim")
    folder = out or Path("out") / f"registration-{Path(station).stem}-{seed}"
    check_out_folder(folder, FILES, [station])
    began = time.perf_counter()
    from trocar.collect.checkerboard import (  # the simulator is heavy
        checkerboard_of,
        draw_registration,
        register_cell,
        registration_table,
    )
    from trocar.lab import load_station, station_text
    from trocar.lab.station_file import with_registered

    loaded = load_station(station)
    checkerboard_of(loaded)  # raises before a progress bar is drawn
    with progress() as tick:
        seeds = np.random.SeedSequence(seed)
        found = register_cell(loaded, seeds, listener=lambda done, total: tick("images of the board", done, total))
    summary = {"station": station, "seed": seed, **found.summary()}
    text, report, picture = (folder / name for name in FILES)
    cameras = {found.camera: (found.T_world_camera, found.calibration.rig)}
    written = with_registered(station_text(station), found.T_world_base, cameras)
    make_folder(folder)
    write_text(text, written, STATION)
    write_json(report, summary, REPORT)
    draw_registration(found, picture)
    lines = [
        f"lenses from {summary['views_used']} of {summary['views_shown']} views: {summary['lenses_rms_px']:.3f} px "
        f"RMS; {summary['minutes_of_a_person']:.0f} min of a person's time; computed in "
        f"{time.perf_counter() - began:.0f} s",
        f"files: {text}, {report}, {picture}",
    ]
    return Result(summary, lines, [registration_table(summary)])
