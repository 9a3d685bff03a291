"""Picture and table of a registration by a checkerboard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.table import Table

from trocar.collect.checkerboard import CellRegistration, checkerboard_of
from trocar.files.output import write_figure
from trocar.geometry.arrays import Array

BRIGHTEST = 230
"""Grey level that the brightest pixels of a picture get."""
MARGIN_PX = 90
"""Margin round the corners in a picture."""


def draw_registration(found: CellRegistration, path: str | Path) -> Path:
    """Draw the board on each bracket in both eyes with the corners found, and where it was shown by hand."""
    figure = Figure(figsize=(14, 4.6 * (len(found.views) + 1)), layout="constrained", dpi=90)
    grid = figure.add_gridspec(len(found.views) + 1, 2)
    for row, (arm, view) in enumerate(found.views.items()):
        eyes = (("left", view.image.left, view.left_px), ("right", view.image.right, view.right_px))
        for column, (eye, picture, corners) in enumerate(eyes):
            axes = figure.add_subplot(grid[row, column])
            _draw_corners(axes, found, picture, corners)
            axes.set_title(f"bracket on {arm!r}, {eye} eye: {found.poses[arm].rms_px:.2f} px RMS")
    for column, eye in enumerate(("left", "right")):
        _draw_hand(figure.add_subplot(grid[-1, column]), found, column, eye)
    figure.suptitle(
        f"{found.station.name}: lenses from {len(found.hand_px)} of {found.shown} views by hand, "
        f"{found.calibration.rms_px:.2f} px RMS"
    )
    return write_figure(path, figure)


def _draw_corners(axes: Axes, found: CellRegistration, picture: NDArray[np.uint8], corners: Array) -> None:
    board = checkerboard_of(found.station).board
    bright = cv2.convertScaleAbs(picture, alpha=BRIGHTEST / max(float(picture.max()), 1.0))
    drawn = cv2.drawChessboardCorners(
        np.ascontiguousarray(bright), (board.columns, board.rows), corners.astype(np.float32)[:, None], True
    )
    axes.imshow(drawn)
    u, v = corners[0].tolist()
    axes.text(u, v, "first ", color="white", backgroundcolor="black", ha="right", va="bottom")
    (left, top), (right, bottom) = corners.min(0) - MARGIN_PX, corners.max(0) + MARGIN_PX
    axes.set_xlim(max(left, 0), min(right, picture.shape[1]))
    axes.set_ylim(min(bottom, picture.shape[0]), max(top, 0))
    axes.set_axis_off()


def _draw_hand(axes: Axes, found: CellRegistration, column: int, eye: str) -> None:
    lens = found.calibration.rig.left if column == 0 else found.calibration.rig.right
    for view in found.hand_px[:, column]:
        axes.plot(*view.T, ".", ms=2)
    axes.set_xlim(0, lens.width)
    axes.set_ylim(lens.height, 0)
    axes.set_aspect("equal")
    axes.set_title(f"corners of all views by hand, {eye} eye")
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def registration_table(figures: dict[str, Any]) -> Table:
    """Return the figures of a registration's summary."""
    table = Table(title="registration by a checkerboard")
    table.add_column("", justify="left")
    arms = list(figures["T_world_base"])
    for name in arms:
        table.add_column(name, justify="right")
    off = figures["off"]
    table.add_row("board on its bracket, RMS px", *(f"{figures['boards_rms_px'][name]:.3f}" for name in arms))
    for what, title in (("camera_to_base", "camera to base"), ("base_to_base", f"base of {arms[0]!r} to base")):
        for unit, digits in (("mm", 2), ("deg", 3)):
            cells = (f"{off[what][name][unit]:.{digits}f}" if name in off[what] else "" for name in arms)
            table.add_row(f"{title}, off by {unit}", *cells)
    table.add_row("a place that is seen, off by mm", *(f"{off['places_mm'][name]:.2f}" for name in arms))
    return table
