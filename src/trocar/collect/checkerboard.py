"""Register a cell with a checkerboard, held by hand for the lenses and by a bracket on each base for the poses.

The poses of the bases relative to each other follow from their poses in the camera's frame (Kehoe et al. 2014, IV-B).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from trocar.collect.plan import Listener
from trocar.errors import InvalidInput
from trocar.files.output import write_figure
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.lab import CheckerboardRegistration, Station
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project
from trocar.perception.image import StereoImage, StereoRig
from trocar.perception.stereo import triangulate
from trocar.perception.stereo_calibration import (
    BoardPose,
    StereoCalibration,
    board_pose,
    calibrate_stereo,
    find_corners,
)
from trocar.sim.calibration_cells import CheckerboardCell

HAND_S, BRACKET_S = 6.0, 120.0
"""Time that a person takes for one pose by hand, and to mount a bracket, take the image and remove it (assumed)."""
BELOW_M = 0.04  # if no fixture is called 'table', the table lies this much below the board on its bracket (assumed)
PLACES_M = (0.04, 0.03, 0.02)
"""Half sides of the box round the board in which position errors are evaluated, along the board's axes."""
BRIGHTEST = 230  # grey level that the brightest pixels of a picture get
MARGIN_PX = 90  # margin round the corners in a picture


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board as both eyes saw it."""

    image: StereoImage
    left_px: Array  # (n, 2) corners in the left image, in the board's order
    right_px: Array  # (n, 2) likewise


@dataclass(frozen=True, eq=False)
class CellRegistration:
    """The result of registering a cell with a checkerboard."""

    station: Station  # the cell; its true poses and lenses are used only to compute errors
    camera: str  # name of the camera
    calibration: StereoCalibration  # of its lenses
    shown: int  # views that a person held before the camera
    hand_px: Array  # (m, 2, n, 2) corners of the views in which both eyes found them, left and right
    views: Mapping[str, BoardView]  # the view of the board on each arm's bracket
    poses: Mapping[str, BoardPose]  # of these boards
    T_world_camera: SE3  # pose of the camera as found
    T_world_base: Mapping[str, SE3]  # bases as found; that of the first arm is the world's reference

    @property
    def duration_s(self) -> float:
        """Return the time that a person spends at the robot."""
        return HAND_S * self.shown + BRACKET_S * len(self.views)

    def errors(self) -> dict[str, Any]:
        """Return all errors against the simulator's truth, in mm and deg, as JSON values."""
        arms, seen_by = self.station.arms, self.station.cameras[self.camera]
        first = next(iter(arms))
        found: dict[str, Any] = {"camera_to_base": {}, "base_to_base": {}, "places_mm": {}}
        for name, arm in arms.items():
            T_camera_base = seen_by.T_world_camera.inverse() @ arm.T_world_base
            T_camera_found = self.T_world_camera.inverse() @ self.T_world_base[name]
            found["camera_to_base"][name] = apart(T_camera_base, T_camera_found)
            found["places_mm"][name] = 1e3 * self._places_off_m(T_camera_base, T_camera_found)
            if name != first:
                T_first_base = arms[first].T_world_base.inverse() @ arm.T_world_base
                T_first_found = self.T_world_base[first].inverse() @ self.T_world_base[name]
                found["base_to_base"][name] = apart(T_first_base, T_first_found)
        return found

    def _places_off_m(self, T_camera_base: SE3, T_camera_found: SE3) -> float:
        """Return the mean position error of points near the board, in the frame of a base."""
        seen_by = self.station.cameras[self.camera]
        true = seen_by.model
        assert isinstance(true, StereoRig)
        steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), -1).reshape(-1, 3) * PLACES_M
        T_left_board = seen_by.T_world_camera.inverse() @ checkerboard_of(self.station).T_world_board
        p_left = T_left_board.apply(steps)
        right_px = project(true.right, true.T_left_right.inverse().apply(p_left))
        p_found, _ = triangulate(self.calibration.rig, project(true.left, p_left), right_px)
        off = T_camera_found.inverse().apply(p_found) - T_camera_base.inverse().apply(p_left)
        return float(np.linalg.norm(off, axis=-1).mean())

    def summary(self) -> dict[str, Any]:
        """Return the report's figures as JSON values."""
        return {
            "views_shown": self.shown,
            "views_used": len(self.hand_px),
            "lenses_rms_px": self.calibration.rms_px,
            "boards_rms_px": {name: pose.rms_px for name, pose in self.poses.items()},
            "minutes_of_a_person": round(self.duration_s / 60, 2),
            "T_world_camera": self.T_world_camera.matrix.tolist(),
            "T_world_base": {name: T.matrix.tolist() for name, T in self.T_world_base.items()},
            "off": self.errors(),
        }


def apart(true: SE3, found: SE3) -> dict[str, float]:
    """Return the distance (``mm``) and angle (``deg``) between a pose and the true one."""
    off = true.inverse() @ found
    return {"mm": 1e3 * float(np.linalg.norm(off.translation_m)), "deg": float(np.degrees(off.rotation.angle()))}


def checkerboard_of(station: Station) -> CheckerboardRegistration:
    """Return the checkerboard registration of a station (TrocarError: it is registered in another way)."""
    if not isinstance(station.registration, CheckerboardRegistration):
        remedy = 'give its [registration] kind = "checkerboard", or choose raven-pair'
        raise InvalidInput(f"station {station.name!r}", "is registered by points", remedy)
    return station.registration


def stereo_camera(station: Station) -> str:
    """Return the name of a station's first stereo pair (TrocarError: there is none)."""
    found = [name for name, camera in station.cameras.items() if isinstance(camera.model, StereoRig)]
    if not found:
        raise InvalidInput(f"station {station.name!r}", "has no stereo pair, which a checkerboard needs", "add one")
    return found[0]


def register_cell(
    station: Station, seeds: np.random.SeedSequence, *, listener: Listener | None = None
) -> CellRegistration:
    """Calibrate a pair's lenses and register camera and bases, all from simulated images of a checkerboard.

    Args:
        station: the cell.
        seeds: seeds of the person's hand, the brackets' errors and the images.
        listener: called after each image.

    Raises:
        TrocarError: the station has no checkerboard or no stereo pair, or the camera does not see the board.
    """
    how, camera = checkerboard_of(station), stereo_camera(station)
    hand, brackets, images = (np.random.default_rng(seed) for seed in seeds.spawn(3))
    table = station.T_world_fixture.get("table")
    table_z_m = how.T_world_board.translation_m[2] - BELOW_M if table is None else table.translation_m[2]
    cell = CheckerboardCell(station, camera, how.board, float(table_z_m))
    distance_m = float(station.cameras[camera].T_world_camera.inverse().apply(how.T_world_board.translation_m)[2])
    total, done = how.views + len(station.arms), 0

    def look(T_world_board: SE3) -> BoardView | None:
        nonlocal done
        view = _seen(how.board, cell.image(T_world_board, images))
        done += 1
        if listener is not None:
            listener(done, total)
        return view

    held = [view for _ in range(how.views) if (view := look(cell.hand_pose(hand, distance_m))) is not None]
    hand_px = np.array([(view.left_px, view.right_px) for view in held]).reshape(-1, 2, len(how.board.corners_m), 2)
    rig = station.cameras[camera].model
    assert isinstance(rig, StereoRig)
    size = (rig.left.width, rig.left.height)
    calibration = calibrate_stereo(how.board, hand_px[:, 0], hand_px[:, 1], size)

    sd = np.repeat([how.bracket_sd_m, how.bracket_sd_rad], 3)
    views, poses, T_camera_base = {}, {}, {}
    for name, arm in station.arms.items():
        T_base_board = arm.T_world_base.inverse() @ how.T_world_board  # as the bracket was made to hold it
        view = look(arm.T_world_base @ T_base_board @ SE3.exp(sd * brackets.standard_normal(6)))
        if view is None:
            remedy = f"move 'board' in [registration] of station {station.name!r}"
            problem = f"does not see the whole board on the bracket of arm {name!r}"
            raise InvalidInput(f"camera {camera!r}", problem, remedy)
        views[name], poses[name] = view, board_pose(how.board, calibration.rig, view.left_px, view.right_px)
        T_camera_base[name] = poses[name].T_left_board @ T_base_board.inverse()
    first = next(iter(station.arms))
    T_world_camera = station.arms[first].T_world_base @ T_camera_base[first].inverse()
    bases = {name: T_world_camera @ T for name, T in T_camera_base.items()}
    return CellRegistration(station, camera, calibration, how.views, hand_px, views, poses, T_world_camera, bases)


def _seen(board: Checkerboard, image: StereoImage) -> BoardView | None:
    """Return the corners in both eyes; None if they are not found in one of them."""
    left, right = find_corners(board, image.left), find_corners(board, image.right)
    return None if left is None or right is None else BoardView(image, left, right)


def draw_registration(found: CellRegistration, path: str | Path) -> Path:
    """Draw the board on each bracket in both eyes with the corners found, and where it was shown by hand."""
    figure = Figure(figsize=(14, 4.6 * (len(found.views) + 1)), layout="constrained", dpi=90)
    all_axes = figure.subplots(len(found.views) + 1, 2, squeeze=False)
    board, rig = checkerboard_of(found.station).board, found.calibration.rig
    for row, (arm, view) in zip(all_axes[:-1], found.views.items(), strict=True):
        eyes = (("left", view.image.left, view.left_px), ("right", view.image.right, view.right_px))
        for axes, (eye, picture, corners) in zip(row, eyes, strict=True):
            bright = cv2.convertScaleAbs(picture, alpha=BRIGHTEST / max(float(picture.max()), 1.0))
            pixels = corners.astype(np.float32)[:, None]
            size = (board.columns, board.rows)
            axes.imshow(cv2.drawChessboardCorners(np.ascontiguousarray(bright), size, pixels, True))
            axes.text(*corners[0], "first ", color="white", backgroundcolor="black", ha="right", va="bottom")
            (left, top), (right, bottom) = corners.min(0) - MARGIN_PX, corners.max(0) + MARGIN_PX
            axes.set_xlim(max(left, 0), min(right, picture.shape[1]))
            axes.set_ylim(min(bottom, picture.shape[0]), max(top, 0))
            axes.set_title(f"bracket on {arm!r}, {eye} eye: {found.poses[arm].rms_px:.2f} px RMS")
            axes.set_axis_off()
    for column, (eye, lens) in enumerate((("left", rig.left), ("right", rig.right))):
        axes = all_axes[-1, column]
        for view_px in found.hand_px[:, column]:
            axes.plot(*view_px.T, ".", ms=2)
        axes.set(xlim=(0, lens.width), ylim=(lens.height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        axes.set_title(f"corners of all views by hand, {eye} eye")
    lenses = f"lenses from {len(found.hand_px)} of {found.shown} views by hand, {found.calibration.rms_px:.2f} px RMS"
    figure.suptitle(f"{found.station.name}: {lenses}")
    return write_figure(path, figure)


def registration_table(figures: dict[str, Any]) -> Table:
    """Return a table of a registration's summary."""
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
