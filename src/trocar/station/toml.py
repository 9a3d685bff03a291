"""A station from a TOML file; every key is checked, unknown ones are refused."""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ARMS, MOTION_LIMITS, ArmModel, MotionLimits
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX, MotionBox
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.image import CameraModel, Intrinsics, StereoRig
from trocar.station.sensor_flaws import SensorFlaws
from trocar.station.station import Registration, Station, StationArm, StationCamera
from trocar.station.transmission import TRANSMISSIONS

RIGID = 1e-3
"""Printed rotations have four digits; within this they are made exact, beyond it they are no rotations."""
MAX_M, MAX_PIXELS = 5.0, 10_000
MODEL_LIMITS = "model"
"""Name of the limits that the arm's own model has."""
BOXES: dict[str, MotionBox] = {"psm1": PSM1_BOX, "psm2": PSM2_BOX}
"""Where the motion of a calibration goes, by name: as the recorded arms went over a peg board."""


def built_in_stations() -> tuple[str, ...]:
    """Return the names of the stations that come with the package."""
    folder = files("trocar.station") / "stations"
    return tuple(sorted(path.name.removesuffix(".toml") for path in folder.iterdir() if path.name.endswith(".toml")))


def load_station(name_or_path: str | Path) -> Station:
    """Return a built-in station by its name, or the one in a TOML file.

    Raises:
        TrocarError: there is none, or its file says something that a station cannot be.

    Example:
        >>> load_station("peg-transfer").arms["psm1"].model.name
        'psm-classic'
    """
    return read_station(*_text(name_or_path))


def station_text(name_or_path: str | Path) -> str:
    """Return the TOML text of a station."""
    return _text(name_or_path)[0]


def station_digest(name_or_path: str | Path) -> str:
    """Return the SHA-256 of a station's text: whether it is still the one that a run was made with."""
    return hashlib.sha256(station_text(name_or_path).encode()).hexdigest()[:16]


def _text(name_or_path: str | Path) -> tuple[str, str]:
    """Return the text of a station, and what to call it in sentences."""
    known = built_in_stations()
    if str(name_or_path) in known:
        text = (files("trocar.station") / "stations" / f"{name_or_path}.toml").read_text(encoding="utf-8")
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
    """Return the station that a TOML text describes; ``where`` names it in sentences."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TrocarError(f"{where} is not TOML: {error}; mend that line") from None
    top = _Table(values, where)
    station = Station(
        name=top.text("name"),
        about=top.text("about"),
        arms={name: _arm(table) for name, table in top.tables("arms").items()},
        cameras={name: _camera(table) for name, table in top.tables("cameras").items()},
        T_world_fixture={name: _pose(table) for name, table in top.tables("fixtures").items()},
        registration=_registration(top.table("registration")),
        min_distance_m=1e-3 * top.number("min_distance_mm", 0.0, 100.0, default=0.0),
    )
    top.close()
    return station


def _arm(table: _Table) -> StationArm:
    model = ARMS[table.choice("model", tuple(ARMS))]
    name = table.choice("transmission", tuple(TRANSMISSIONS))
    arm = StationArm(
        model=model,
        transmission=TRANSMISSIONS[name],
        transmission_name=name,
        limits=_limits(table, model),
        T_world_base=_pose(table.table("base")),
        **_park(table.table("park")),
        workspace_m=_box(table, "workspace_mm"),
        calibration=_calibration(table, model),
        T_world_base_registered=_pose(table.table("registered")) if table.has("registered") else None,
    )
    table.close()
    return arm


def _limits(table: _Table, model: ArmModel) -> MotionLimits:
    name = table.choice("limits", (MODEL_LIMITS, *MOTION_LIMITS), default=MODEL_LIMITS)
    return model.motion_limits if name == MODEL_LIMITS else MOTION_LIMITS[name]


def _park(table: _Table) -> dict[str, Any]:
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


def _calibration(table: _Table, model: ArmModel) -> MotionBox | None:
    name = table.choice("calibration", ("task", *BOXES), default="task")
    if name == "task":
        return None
    box = BOXES[name]
    if (box.lower < model.lower).any() or (box.upper > model.upper).any():
        raise TrocarError(f"{table.where}.calibration {name!r} leaves the joints' ranges of {model.name!r}; use 'task'")
    return box


def _camera(table: _Table) -> StationCamera:
    kind = table.choice("kind", ("rgbd", "stereo"))
    lens = _lens(table.table("lens")).binned(int(table.number("binning", 1, 8, default=1)))
    model: CameraModel = lens
    if kind == "stereo":
        baseline_m = 1e-3 * table.number("baseline_mm", 1.0, 1e3)
        model = StereoRig(lens, lens, SE3.from_parts(translation_m=[baseline_m, 0.0, 0.0]))
    camera = StationCamera(
        model=model,
        T_world_camera=_pose(table.table("pose")),
        exposure_s=1e-3 * table.number("exposure_ms", 0.0, 1e4),
        lamp_m=tuple((1e-3 * table.numbers("lamp_mm", 3, -1e3, 1e3)).tolist()),  # type: ignore[arg-type]
        flaws=_flaws(table.table("flaws")),
        gain=table.number("gain", 0.01, 100.0, default=StationCamera.gain),
    )
    table.close()
    return camera


def _lens(table: _Table) -> Intrinsics:
    width, height = (int(v) for v in table.numbers("size_px", 2, 1, MAX_PIXELS))
    fx, fy = table.numbers("focal_px", 2, 1, 1e5)
    cx, cy = table.numbers("centre_px", 2, -1e4, 1e4)
    distortion = table.numbers("distortion", 5, -10, 10, default=np.zeros(5))
    table.close()
    return Intrinsics(width, height, float(fx), float(fy), float(cx), float(cy), tuple(distortion.tolist()))  # type: ignore[arg-type]


def _flaws(table: _Table) -> SensorFlaws:
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


def _registration(table: _Table) -> Registration:
    usual = Registration()
    box = _box(table, "volume_mm")
    registration = Registration(
        points=int(table.number("points", 4, 1e6, default=usual.points)),
        sd_m=1e-3 * table.number("sd_mm", 0.0, 100.0, default=1e3 * usual.sd_m),
        volume_m=usual.volume_m if box is None else tuple(map(tuple, box.tolist())),  # type: ignore[arg-type]
    )
    table.close()
    return registration


def _box(table: _Table, key: str) -> NDArray[np.float64] | None:
    """Return lower and upper corner (2, 3) in m of a box in mm; None where there is none."""
    if not table.has(key):
        return None
    box = 1e-3 * table.rows(key, 2, 3)
    if not (box[0] < box[1]).all():
        raise TrocarError(f"{table.where}.{key} is no box; give [lower corner, upper corner], lower < upper")
    return box


def _pose(table: _Table) -> SE3:
    """Return a pose: ``xyz_mm`` with ``rpy_deg`` (Rz(yaw) Ry(pitch) Rx(roll)) or ``rotation``, three rows."""
    place = 1e-3 * table.numbers("xyz_mm", 3, -1e3 * MAX_M, 1e3 * MAX_M, default=np.zeros(3))
    if table.has("rotation"):
        given = table.rows("rotation", 3, 3)
        if np.abs(given @ given.T - np.eye(3)).max() > RIGID or np.linalg.det(given) < 0:
            raise TrocarError(f"{table.where}.rotation is no rotation; give three orthonormal rows, determinant +1")
        u, _, vt = np.linalg.svd(given)
        turn = SO3(u @ vt)
    else:
        roll, pitch, yaw = np.radians(table.numbers("rpy_deg", 3, -360.0, 360.0, default=np.zeros(3)))
        turn = SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)
    table.close()
    return SE3.from_parts(turn, place)


class _Table:
    """A TOML table whose keys are asked for one by one; what was not asked for is unknown."""

    def __init__(self, values: object, where: str):
        if not isinstance(values, Mapping):
            raise TrocarError(f"{where} is {values!r}; give a table")
        self._values, self.where = dict(values), where
        self._asked: list[str] = []

    def has(self, key: str) -> bool:
        self._asked.append(key)
        return key in self._values

    def _get(self, key: str, default: Any) -> Any:
        if not self.has(key):
            if default is None:
                raise TrocarError(f"{self.where} has no key {key!r}; add it")
            return default
        return self._values[key]

    def text(self, key: str, default: str | None = None) -> str:
        value = self._get(key, default)
        if not isinstance(value, str) or not value.strip():
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a text")
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        value = self.text(key, default)
        if value not in choices:
            raise TrocarError(f"{self.where}.{key} is {value!r}; choose one of {', '.join(choices)}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise TrocarError(f"{self.where}.{key} is {value!r}; give true or false")
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        return self._number(self._get(key, default), key, low, high)

    def _number(self, value: object, key: str, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a number from {low:g} to {high:g}")
        return float(value)

    def numbers(
        self, key: str, count: int, low: float, high: float, default: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        value = self._get(key, default)
        if isinstance(value, np.ndarray):
            return value
        if not isinstance(value, list) or len(value) != count:
            raise TrocarError(f"{self.where}.{key} is {value!r}; give a list of {count} numbers")
        return np.array([self._number(item, key, low, high) for item in value])

    def rows(self, key: str, rows: int, columns: int) -> NDArray[np.float64]:
        value = self._get(key, None)
        if (
            not isinstance(value, list)
            or len(value) != rows
            or any(not isinstance(row, list) or len(row) != columns for row in value)
        ):
            raise TrocarError(f"{self.where}.{key} is {value!r}; give {rows} lists of {columns} numbers")
        return np.array([[self._number(item, key, -1e4, 1e4) for item in row] for row in value])

    def table(self, key: str) -> _Table:
        return _Table(self._get(key, {}), f"{self.where}.{key}")

    def tables(self, key: str) -> dict[str, _Table]:
        table = self.table(key)
        return {str(name): _Table(value, f"{table.where}.{name}") for name, value in table._values.items()}

    def close(self) -> None:
        """Refuse keys that nobody asked for."""
        unknown = [key for key in self._values if key not in self._asked]
        if unknown:
            known = ", ".join(dict.fromkeys(self._asked))
            raise TrocarError(f"{self.where} has an unknown key {unknown[0]!r}; known are {known}")
