"""A station from a TOML file; every key is checked, unknown ones are refused."""

from __future__ import annotations

import hashlib
import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS, ArmModel, MotionLimits
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX, MotionBox
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.lab.registration import CheckerboardRegistration, Registration
from trocar.lab.sensor_flaws import SensorFlaws
from trocar.lab.station import Station, StationArm, StationCamera
from trocar.lab.table import MAX_M, Table, box, pose
from trocar.lab.transmission import TRANSMISSIONS
from trocar.perception.checkerboard import MAX_CORNERS, MAX_SQUARE_M, MIN_CORNERS, MIN_VIEWS, Checkerboard
from trocar.perception.image import CameraModel, Intrinsics, StereoRig

MAX_PIXELS = 10_000
MAX_VIEWS = 1000
"""Maximum number of views of a checkerboard."""
MODEL_LIMITS = "model"
"""Name of the limits that the arm's own model has."""
BOXES: dict[str, MotionBox] = {"psm1": PSM1_BOX, "psm2": PSM2_BOX}
"""Ranges of a calibration's motion, by name: those of the recorded arms over a peg board."""


def built_in_stations() -> tuple[str, ...]:
    """Return the names of the stations that come with the package."""
    folder = files("trocar.lab") / "stations"
    return tuple(sorted(path.name.removesuffix(".toml") for path in folder.iterdir() if path.name.endswith(".toml")))


def load_station(name_or_path: str | Path) -> Station:
    """Return a built-in station by its name, or the one in a TOML file.

    Raises:
        TrocarError: there is none, or its file describes an impossible station.

    Example:
        >>> load_station("peg-transfer").arms["psm1"].model.name
        'psm-classic'
    """
    return read_station(*_text(name_or_path))


def station_text(name_or_path: str | Path) -> str:
    """Return the TOML text of a station."""
    return _text(name_or_path)[0]


def station_digest(name_or_path: str | Path) -> str:
    """Return the SHA-256 of a station's text, to tell whether it is still the one that a run was made with."""
    return hashlib.sha256(station_text(name_or_path).encode()).hexdigest()[:16]


def _text(name_or_path: str | Path) -> tuple[str, str]:
    """Return the text of a station, and its name in error messages."""
    known = built_in_stations()
    if str(name_or_path) in known:
        text = (files("trocar.lab") / "stations" / f"{name_or_path}.toml").read_text(encoding="utf-8")
        return text, f"built-in station {str(name_or_path)!r}"
    path = Path(name_or_path)
    if path.suffix != ".toml":
        raise TrocarError(f"station {str(path)!r} is unknown; choose one of {', '.join(known)}, or give a .toml file")
    try:
        return path.read_text(encoding="utf-8"), f"station file {str(path)!r}"
    except FileNotFoundError:
        raise TrocarError(
            f"station file {str(path)!r} does not exist; give another, or one of {', '.join(known)}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise TrocarError(f"cannot read station file {str(path)!r} ({error}); give a TOML file in UTF-8") from None


def read_station(text: str, where: str = "the station") -> Station:
    """Return the station that a TOML text describes; ``where`` is its name in error messages."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TrocarError(f"{where} is not TOML: {error}; correct that line") from None
    top = Table(values, where)
    station = Station(
        name=top.text("name"),
        about=top.text("about"),
        arms={name: _arm(table) for name, table in top.tables("arms").items()},
        cameras={name: _camera(table) for name, table in top.tables("cameras").items()},
        T_world_fixture={name: pose(table) for name, table in top.tables("fixtures").items()},
        registration=_registration(top.table("registration")),
        min_distance_m=1e-3 * top.number("min_distance_mm", 0.0, 100.0, default=0.0),
    )
    top.close()
    return station


def _arm(table: Table) -> StationArm:
    model = ARMS[table.choice("model", tuple(ARMS))]
    name = table.choice("transmission", tuple(TRANSMISSIONS))
    arm = StationArm(
        model=model,
        transmission=TRANSMISSIONS[name],
        transmission_name=name,
        limits=_limits(table, model),
        T_world_base=pose(table.table("base")),
        **_park(table.table("park")),
        workspace_m=box(table, "workspace_mm"),
        calibration=_calibration(table, model),
        T_world_base_registered=pose(table.table("registered")) if table.has("registered") else None,
    )
    table.close()
    return arm


def _limits(table: Table, model: ArmModel) -> MotionLimits:
    name = table.choice("limits", (MODEL_LIMITS, *MOTION_LIMITS), default=MODEL_LIMITS)
    return model.motion_limits if name == MODEL_LIMITS else MOTION_LIMITS[name]


def _park(table: Table) -> dict[str, Any]:
    """Return the keyword arguments of how an arm rests."""
    park: dict[str, Any] = {"park_jaw_rad": math.radians(table.number("jaw_deg", -60.0, 180.0, default=5.73))}
    if table.has("tip_mm") and table.has("q"):
        raise TrocarError(f"{table.where} has both 'tip_mm' and 'q'; keep one of them")
    if table.has("tip_mm"):
        park["park"] = 1e-3 * table.numbers("tip_mm", 3, -1e3 * MAX_M, 1e3 * MAX_M)
    elif table.has("q"):
        park["park"] = table.numbers("q", 6, -10.0, 10.0)
    table.close()
    return park


def _calibration(table: Table, model: ArmModel) -> MotionBox | None:
    name = table.choice("calibration", ("task", *BOXES), default="task")
    if name == "task":
        return None
    box = BOXES[name]
    if (box.lower < model.lower).any() or (box.upper > model.upper).any():
        raise TrocarError(f"{table.where}.calibration {name!r} leaves the joints' ranges of {model.name!r}; use 'task'")
    return box


def _camera(table: Table) -> StationCamera:
    kind = table.choice("kind", ("rgbd", "stereo"))
    lens = _lens(table.table("lens")).binned(int(table.number("binning", 1, 8, default=1)))
    model: CameraModel = lens
    if kind == "stereo":
        baseline_m = 1e-3 * table.number("baseline_mm", 1.0, 1e3)
        model = StereoRig(lens, lens, SE3.from_parts(translation_m=[baseline_m, 0.0, 0.0]))
    camera = StationCamera(
        model=model,
        T_world_camera=pose(table.table("pose")),
        exposure_s=1e-3 * table.number("exposure_ms", 0.0, 1e4),
        lamp_m=tuple((1e-3 * table.numbers("lamp_mm", 3, -1e3, 1e3)).tolist()),  # type: ignore[arg-type]
        flaws=_flaws(table.table("flaws")),
        gain=table.number("gain", 0.01, 100.0, default=StationCamera.gain),
        ambient=table.number("ambient", 0.0, 100.0, default=StationCamera.ambient),
        **_camera_registered(table, kind),
    )
    table.close()
    return camera


def _camera_registered(table: Table, kind: str) -> dict[str, Any]:
    """Return the keyword arguments of how a camera was registered."""
    if not table.has("registered"):
        return {}
    registered = table.table("registered")
    found: dict[str, Any] = {"T_world_camera_registered": pose(registered.table("pose"))}
    if kind == "stereo":
        found["rig_registered"] = _rig(registered)
    registered.close()
    return found


def _lens(table: Table) -> Intrinsics:
    width, height = (int(v) for v in table.numbers("size_px", 2, 1, MAX_PIXELS))
    fx, fy = table.numbers("focal_px", 2, 1, 1e5)
    cx, cy = table.numbers("centre_px", 2, -1e4, 1e4)
    distortion = table.numbers("distortion", 5, -10, 10, default=np.zeros(5))
    table.close()
    return Intrinsics(width, height, float(fx), float(fy), float(cx), float(cy), tuple(distortion.tolist()))  # type: ignore[arg-type]


def _flaws(table: Table) -> SensorFlaws:
    """Return the sensor's flaws: those of the table, the rest as the default camera has them."""
    usual = SensorFlaws()
    values: dict[str, Any] = {}
    for name, value in vars(usual).items():
        if isinstance(value, bool):
            values[name] = table.flag(name, value)
        else:
            values[name] = table.number(name, 0.0, 1e3, default=value)
    table.close()
    return SensorFlaws(**values)


def _registration(table: Table) -> Registration | CheckerboardRegistration:
    kind = table.choice("kind", ("points", "checkerboard"), default="points")
    registration = _points(table) if kind == "points" else _checkerboard(table)
    table.close()
    return registration


def _points(table: Table) -> Registration:
    usual = Registration()
    corners = box(table, "volume_mm")
    return Registration(
        points=int(table.number("points", 4, 1e6, default=usual.points)),
        sd_m=1e-3 * table.number("sd_mm", 0.0, 100.0, default=1e3 * usual.sd_m),
        volume_m=usual.volume_m if corners is None else tuple(map(tuple, corners.tolist())),  # type: ignore[arg-type]
    )


def _checkerboard(table: Table) -> CheckerboardRegistration:
    usual, board = CheckerboardRegistration(), Checkerboard()

    def angle(key: str, default_rad: float) -> float:
        return math.radians(table.number(key, 0.0, 10.0, default=math.degrees(default_rad)))

    return CheckerboardRegistration(
        board=Checkerboard(
            columns=int(table.number("columns", MIN_CORNERS, MAX_CORNERS, default=board.columns)),
            rows=int(table.number("rows", MIN_CORNERS, MAX_CORNERS, default=board.rows)),
            square_m=1e-3 * table.number("square_mm", 0.1, 1e3 * MAX_SQUARE_M, default=1e3 * board.square_m),
        ),
        T_world_board=pose(table.table("board")),
        sd_m=1e-3 * table.number("sd_mm", 0.0, 100.0, default=1e3 * usual.sd_m),
        sd_rad=angle("sd_deg", usual.sd_rad),
        bracket_sd_m=1e-3 * table.number("bracket_mm", 0.0, 100.0, default=1e3 * usual.bracket_sd_m),
        bracket_sd_rad=angle("bracket_deg", usual.bracket_sd_rad),
        views=int(table.number("views", MIN_VIEWS, MAX_VIEWS, default=usual.views)),
    )


def _rig(table: Table) -> StereoRig | None:
    """Return the lenses of a pair as they were found, or None if only its pose was found."""
    if not table.has("left"):
        return None
    return StereoRig(_lens(table.table("left")), _lens(table.table("right")), pose(table.table("right_pose")))
