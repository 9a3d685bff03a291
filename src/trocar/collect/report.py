"""Picture and tables of a calibration from images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.table import Table

from trocar.calibration.recording import JOINT_NAMES
from trocar.collect.chain import Calibrated
from trocar.files.output import write_figure
from trocar.perception.depth import project

DISTANCE_TARGET_MM, JOINT_TARGET_RAD = 0.35, 0.01
"""Targets: RMS error of distances between spheres, and of the measured joints (the paper: .32 mm, below .01 rad)."""
BRIGHTER = 1.6


def joint_error(joint: int, error: float) -> tuple[str, str]:
    """Return the error of a joint, rad or m, as shown in pictures and tables, and its unit."""
    return (f"{1e3 * error:.2f}", "mm") if JOINT_NAMES[joint] == "q3" else (f"{error:.4f}", "rad")


def draw_calibration(found: Calibrated, path: str | Path) -> Path:
    """Draw an image with the spheres found, distances between spheres, and the joints' errors over time."""
    figure = Figure(figsize=(14, 8), layout="constrained", dpi=110)
    grid = figure.add_gridspec(2, 3)
    _draw_image(figure.add_subplot(grid[0, 0]), found)
    _draw_distances(figure.add_subplot(grid[0, 1]), found)
    _draw_outer(figure.add_subplot(grid[0, 2]), found)
    _draw_wrist(figure.add_subplot(grid[1, :]), found)
    figure.suptitle(
        f"{found.collection.arm}: {int(found.recording.valid.sum())} of {len(found.recording)} rows are good"
    )
    return write_figure(path, figure)


def _draw_image(axes: Axes, found: Calibrated) -> None:
    """Draw the image of the middle good row, with an outline round each accepted sphere."""
    rows = np.flatnonzero(found.recording.valid)
    row = int(rows[len(rows) // 2])
    image = found.collection.image(row)
    axes.imshow(cv2.convertScaleAbs(image.color, alpha=BRIGHTER))
    centers = found.measured.p_camera_m[row]
    for center, radius in zip(centers, found.collection.fixture.radii_m, strict=True):
        if np.isfinite(center).all():
            u, v = project(image.intrinsics, center)
            outline = radius * image.intrinsics.fx / center[2]
            axes.add_patch(Circle((u, v), outline, fill=False, color="white", lw=1.0, ls="--"))
    axes.set_title(f"row {row}: spheres found")
    axes.set_axis_off()


def _draw_distances(axes: Axes, found: Calibrated) -> None:
    axes.hist(1e3 * found.distance_error_m, bins=60, color="#1f6fb4")
    axes.set_title(f"distances between spheres: {1e3 * found.measured.distance_rms_m:.2f} mm RMS")
    axes.set_xlabel("measured - printed [mm]")
    _plain(axes)


def _draw_outer(axes: Axes, found: Calibrated) -> None:
    error = found.joint_error[:, :3]
    rms = np.sqrt(np.mean(error**2, axis=0))
    for joint in range(3):
        label = f"{JOINT_NAMES[joint]}: {' '.join(joint_error(joint, rms[joint]))} RMS"
        axes.hist(1e3 * error[:, joint], bins=60, histtype="step", lw=1.4, label=label)
    axes.set_title("outer joints")
    axes.set_xlabel("measured - true [mrad, mm]")
    axes.legend(loc="upper right")
    _plain(axes)


def _draw_wrist(axes: Axes, found: Calibrated) -> None:
    rows = found.recording.valid
    minutes = found.recording.t_s[rows] / 60
    error = found.joint_error
    for joint in (3, 4, 5):
        rms = float(np.sqrt(np.mean(error[:, joint] ** 2)))
        axes.plot(
            minutes, error[:, joint], ".", ms=3, label=f"{JOINT_NAMES[joint]}: {' '.join(joint_error(joint, rms))} RMS"
        )
    for edge in (-JOINT_TARGET_RAD, JOINT_TARGET_RAD):
        axes.axhline(edge, color="#8a8f98", lw=1.0, ls="--")
    axes.set_title("wrist: measured - true joints (dashed: the limit on the RMS)")
    axes.set_xlabel("time on the robot [min]")
    axes.set_ylabel("[rad]")
    axes.legend(loc="upper right", ncols=3)
    _plain(axes)


def _plain(axes: Axes) -> None:
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def collection_table(arms: dict[str, dict[str, Any]]) -> Table:
    """Return the figures of all arms beside the targets."""
    table = Table(title="calibration from images")
    table.add_column("", justify="left")
    for name in arms:
        table.add_column(name, justify="right")
    table.add_column("must hold", justify="right")
    every = list(arms.values())
    table.add_row("good rows", *(f"{a['good_rows']} of {a['rows']}" for a in every), "")
    table.add_row("time on the robot, min", *(f"{a['simulated_minutes']:.1f}" for a in every), "18 for 1355")
    distances = (f"{a['sphere_distance_rms_mm']:.2f}" for a in every)
    table.add_row("sphere distances, mm RMS", *distances, f"{DISTANCE_TARGET_MM:g}")
    for joint, name in enumerate(JOINT_NAMES):
        shown = [joint_error(joint, a["joint_rms"][joint]) for a in every]
        limit = "" if name == "q3" else f"{JOINT_TARGET_RAD:g}"
        table.add_row(f"{name} measured - true, {shown[0][1]} RMS", *(value for value, _ in shown), limit)
    registrations = [a["registration"] for a in every]
    table.add_row("base off, mm", *(f"{r['off_mm']:.2f}" for r in registrations), "")
    table.add_row("base off, deg", *(f"{r['off_deg']:.3f}" for r in registrations), "")
    if all("model" in a for a in every):
        for joint in (3, 4, 5):
            both = ((a["model"]["rmse_before"][joint], a["model"]["rmse_after"][joint]) for a in every)
            table.add_row(f"{JOINT_NAMES[joint]} held out, rad RMSE", *(f"{b:.4f} -> {c:.4f}" for b, c in both), "")
    return table
