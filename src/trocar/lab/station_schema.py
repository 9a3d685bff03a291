"""The schema of a station file, checked by pydantic; an error becomes one sentence that names the key."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import fields
from difflib import get_close_matches
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, field_validator, model_validator
from pydantic_core import PydanticCustomError

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.lab.station import CheckerboardRegistration, Registration, SensorFlaws, Station, StationArm, StationCamera
from trocar.lab.topics import MAX_DOMAIN, Command, Dialect, Topics
from trocar.lab.transmission import TRANSMISSIONS
from trocar.perception.checkerboard import MAX_CORNERS, MAX_SQUARE_M, MIN_CORNERS, MIN_VIEWS, Checkerboard
from trocar.perception.image import Intrinsics, StereoRig

MODEL_LIMITS = "model"
"""Name for the limits of the arm's own model."""
BOXES = {"psm1": PSM1_BOX, "psm2": PSM2_BOX}
"""Ranges of a calibration's motion, by name; they are those of the recorded arms over a peg board."""
RIGID = 1e-3
"""Tolerance of a rotation matrix. Printed ones have four digits; within the tolerance they are made orthonormal."""
TO_M = 1e-3

Text = Annotated[str, Field(pattern=r"\S")]
Place = Annotated[list[Annotated[float, Field(ge=-5000, le=5000)]], Field(min_length=3, max_length=3)]
"""A point in mm."""
Row = Annotated[list[Annotated[float, Field(ge=-1e4, le=1e4)]], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Annotated[float, Field(ge=-1e4, le=1e5)]], Field(min_length=2, max_length=2)]
Corners = Annotated[list[Row], Field(min_length=2, max_length=2)]
"""Lower and upper corner of a box in mm."""

Model = TypeVar("Model", bound="Table")


class Table(BaseModel):
    """A table of a TOML file: every key is known, every value has its type."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown(cls, values: Any) -> Any:
        for key in values if isinstance(values, Mapping) else ():
            if key not in cls.model_fields:
                raise PydanticCustomError("unknown_key", "unknown", {"key": key, "known": tuple(cls.model_fields)})
        return values


def validated(model: type[Model], values: object, where: str) -> Model:
    """Return a table as an instance of its model.

    Raises:
        InvalidInput: the table does not match; the message is its first fault in one sentence.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _refusal(error.errors()[0], where) from None


def _refusal(fault: Any, where: str) -> InvalidInput:
    """Return one fault that pydantic reports as an InvalidInput."""
    keys = [key for key in fault["loc"] if isinstance(key, str)]
    item, about = ".".join([where, *keys]), fault.get("ctx", {})
    if fault["type"] == "missing":
        return InvalidInput(".".join([where, *keys[:-1]]), f"has no key {keys[-1]!r}", "add it")
    if fault["type"] == "unknown_key":
        meant = get_close_matches(about["key"], about["known"], n=1)
        hint = f"did you mean {meant[0]!r}? " if meant else ""
        return InvalidInput(
            item, f"has an unknown key {about['key']!r}", f"{hint}known are {', '.join(about['known'])}"
        )
    if fault["type"] == "model_type":
        return InvalidValue(item, repr(fault["input"]), "give a table")
    if fault["type"] == "value_error":
        return InvalidInput(f"{item}:", str(about["error"]))
    return InvalidValue(item, repr(fault["input"]), fault["msg"].replace("Input should", "it should"))


class PoseTable(Table):
    """A pose: ``xyz_mm`` with ``rpy_deg`` (Rz(yaw) Ry(pitch) Rx(roll)) or the three rows of ``rotation``."""

    xyz_mm: Place = [0.0, 0.0, 0.0]
    rpy_deg: Row | None = None
    rotation: Annotated[list[Row], Field(min_length=3, max_length=3)] | None = None

    @model_validator(mode="after")
    def _require_rotation(self) -> PoseTable:
        if self.rotation is not None and self.rpy_deg is not None:
            raise InvalidInput("it", "has both 'rpy_deg' and 'rotation'", "keep one of them")
        if self.rotation is not None:
            R = np.array(self.rotation)
            if np.abs(R @ R.T - np.eye(3)).max() > RIGID or np.linalg.det(R) < 0:
                raise InvalidInput("rotation", "is not a rotation", "give three orthonormal rows, determinant +1")
        return self

    @property
    def T(self) -> SE3:
        """Return the pose."""
        if self.rotation is not None:
            turn = SO3.nearest(self.rotation)
        else:
            roll, pitch, yaw = np.radians(self.rpy_deg or np.zeros(3))
            turn = SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)
        return SE3.from_parts(turn, TO_M * np.array(self.xyz_mm))


def _box_m(corners: Corners | None) -> Array | None:
    return None if corners is None else TO_M * np.array(corners, dtype=np.float64)


def _require_box(corners: Corners | None) -> Corners | None:
    if corners is not None and not (np.array(corners[0]) < corners[1]).all():
        raise InvalidInput("it", "is not a box", "give [lower corner, upper corner], lower < upper")
    return corners


class ParkTable(Table):
    """How an arm rests."""

    jaw_deg: Annotated[float, Field(ge=-60, le=180)] = 5.73
    tip_mm: Place | None = None
    q: Annotated[list[Annotated[float, Field(ge=-10, le=10)]], Field(min_length=6, max_length=6)] | None = None

    @model_validator(mode="after")
    def _require_one(self) -> ParkTable:
        if self.tip_mm is not None and self.q is not None:
            raise InvalidInput("it", "has both 'tip_mm' and 'q'", "keep one of them")
        return self

    @property
    def park(self) -> Array | None:
        """Return a tip (3,) m, joints (6,), or None."""
        if self.tip_mm is not None:
            return TO_M * np.array(self.tip_mm, dtype=np.float64)
        return None if self.q is None else np.array(self.q, dtype=np.float64)


class ArmTable(Table):
    """One arm."""

    model: str
    transmission: str
    limits: str = MODEL_LIMITS
    speed: Annotated[float, Field(ge=0.01, le=1)] = 1.0
    base: PoseTable = Field(default_factory=PoseTable)
    park: ParkTable = Field(default_factory=ParkTable)
    workspace_mm: Corners | None = None
    calibration: Literal["task", "psm1", "psm2"] = "task"
    registered: PoseTable | None = None

    _workspace = field_validator("workspace_mm")(_require_box)

    @field_validator("model", "transmission", "limits")
    @classmethod
    def _require_name(cls, name: str, info: Any) -> str:
        if info.field_name == "limits":
            if name not in (MODEL_LIMITS, *MOTION_LIMITS):
                raise UnknownName("a set of limits", name, (MODEL_LIMITS, *MOTION_LIMITS))
        else:
            (ARMS if info.field_name == "model" else TRANSMISSIONS).pick(name)
        return name

    @model_validator(mode="after")
    def _require_range(self) -> ArmTable:
        box, model = BOXES.get(self.calibration), ARMS[self.model]
        if box is not None and ((box.lower < model.lower).any() or (box.upper > model.upper).any()):
            raise InvalidInput(
                f"calibration {self.calibration!r}", f"leaves the joints' ranges of {model.name!r}", "use 'task'"
            )
        return self

    def made(self) -> StationArm:
        """Return the arm."""
        model = ARMS[self.model]
        limits = model.motion_limits if self.limits == MODEL_LIMITS else MOTION_LIMITS[self.limits]
        return StationArm(
            model=model,
            transmission=TRANSMISSIONS[self.transmission],
            transmission_name=self.transmission,
            limits=limits.slowed(self.speed),
            T_world_base=self.base.T,
            park=self.park.park,
            park_jaw_rad=math.radians(self.park.jaw_deg),
            workspace_m=_box_m(self.workspace_mm),
            calibration=BOXES.get(self.calibration),
            T_world_base_registered=self.registered and self.registered.T,
        )


class LensTable(Table):
    """The lens of a camera."""

    size_px: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], Field(min_length=2, max_length=2)]
    focal_px: Annotated[list[Annotated[float, Field(ge=1, le=1e5)]], Field(min_length=2, max_length=2)]
    centre_px: Pair
    distortion: Annotated[list[Annotated[float, Field(ge=-10, le=10)]], Field(min_length=5, max_length=5)] = [0.0] * 5

    def made(self) -> Intrinsics:
        """Return the lens."""
        (width, height), (fx, fy), (cx, cy) = self.size_px, self.focal_px, self.centre_px
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(self.distortion))  # type: ignore[arg-type]


class RegisteredTable(Table):
    """How a camera was registered."""

    pose: PoseTable = Field(default_factory=PoseTable)
    left: LensTable | None = None
    right: LensTable | None = None
    right_pose: PoseTable | None = None

    @property
    def rig(self) -> StereoRig | None:
        """Return the lenses of a pair as calibrated, or None if only its pose was registered."""
        if self.left is None or self.right is None or self.right_pose is None:
            return None
        return StereoRig(self.left.made(), self.right.made(), self.right_pose.T)


FlawsTable = create_model(
    "FlawsTable",
    __base__=Table,
    **{
        flaw.name: (bool, flaw.default)
        if isinstance(flaw.default, bool)
        else (float, Field(flaw.default, ge=0, le=1e3))
        for flaw in fields(SensorFlaws)
    },  # type: ignore[call-overload]
)
"""The sensor's flaws; those that the table leaves out have the values of the default camera."""


class CameraTable(Table):
    """One camera."""

    kind: Literal["rgbd", "stereo"]
    lens: LensTable
    pose: PoseTable = Field(default_factory=PoseTable)
    binning: int = Field(1, ge=1, le=8)
    baseline_mm: float | None = Field(None, ge=1, le=1e3)
    exposure_ms: float = Field(ge=0, le=1e4)
    lamp_mm: Place
    gain: float = Field(StationCamera.gain, ge=0.01, le=100)
    ambient: float = Field(StationCamera.ambient, ge=0, le=100)
    flaws: FlawsTable = Field(default_factory=FlawsTable)  # type: ignore[valid-type]
    registered: RegisteredTable | None = None

    @model_validator(mode="after")
    def _require_pair(self) -> CameraTable:
        if (self.kind == "stereo") != (self.baseline_mm is not None):
            problem, remedy = ("no", "add it") if self.kind == "stereo" else ("a", "take it out")
            raise InvalidInput(f"a camera of kind {self.kind!r}", f"has {problem} key 'baseline_mm'", remedy)
        if self.kind == "rgbd" and self.registered is not None and self.registered.rig is not None:
            raise InvalidInput("a camera of kind 'rgbd'", "has registered lenses", "keep the pose alone")
        return self

    def made(self) -> StationCamera:
        """Return the camera."""
        lens = self.lens.made().binned(self.binning)
        model: Intrinsics | StereoRig = lens
        if self.baseline_mm is not None:
            model = StereoRig(lens, lens, SE3.from_parts(translation_m=[TO_M * self.baseline_mm, 0.0, 0.0]))
        return StationCamera(
            model=model,
            T_world_camera=self.pose.T,
            exposure_s=1e-3 * self.exposure_ms,
            lamp_m=tuple((TO_M * np.array(self.lamp_mm)).tolist()),  # type: ignore[arg-type]
            flaws=SensorFlaws(**self.flaws.model_dump()),
            gain=float(self.gain),
            ambient=float(self.ambient),
            T_world_camera_registered=self.registered and self.registered.pose.T,
            rig_registered=self.registered and self.registered.rig,
        )


_POINTS, _BOARDS, _BOARD = Registration(), CheckerboardRegistration(), Checkerboard()


class PointsTable(Table):
    """Bases are registered by points."""

    kind: Literal["points"] = "points"
    points: int = Field(_POINTS.points, ge=4, le=10**6)
    sd_mm: float = Field(1e3 * _POINTS.sd_m, ge=0, le=100)
    volume_mm: Corners | None = None

    _volume = field_validator("volume_mm")(_require_box)

    def made(self) -> Registration:
        """Return the registration."""
        box_m = _box_m(self.volume_mm)
        volume = _POINTS.volume_m if box_m is None else tuple(map(tuple, box_m.tolist()))
        return Registration(points=self.points, sd_m=TO_M * self.sd_mm, volume_m=volume)  # type: ignore[arg-type]


class CheckerboardTable(Table):
    """Bases are registered by a checkerboard on brackets."""

    kind: Literal["checkerboard"]
    columns: int = Field(_BOARD.columns, ge=MIN_CORNERS, le=MAX_CORNERS)
    rows: int = Field(_BOARD.rows, ge=MIN_CORNERS, le=MAX_CORNERS)
    square_mm: float = Field(1e3 * _BOARD.square_m, ge=0.1, le=1e3 * MAX_SQUARE_M)
    board: PoseTable = Field(default_factory=PoseTable)
    sd_mm: float = Field(1e3 * _BOARDS.sd_m, ge=0, le=100)
    sd_deg: float = Field(math.degrees(_BOARDS.sd_rad), ge=0, le=10)
    bracket_mm: float = Field(1e3 * _BOARDS.bracket_sd_m, ge=0, le=100)
    bracket_deg: float = Field(math.degrees(_BOARDS.bracket_sd_rad), ge=0, le=10)
    views: int = Field(_BOARDS.views, ge=MIN_VIEWS, le=1000)

    def made(self) -> CheckerboardRegistration:
        """Return the registration."""
        return CheckerboardRegistration(
            board=Checkerboard(columns=self.columns, rows=self.rows, square_m=TO_M * self.square_mm),
            T_world_board=self.board.T,
            sd_m=TO_M * self.sd_mm,
            sd_rad=math.radians(self.sd_deg),
            bracket_sd_m=TO_M * self.bracket_mm,
            bracket_sd_rad=math.radians(self.bracket_deg),
            views=self.views,
        )


REGISTRATIONS = {"points": PointsTable, "checkerboard": CheckerboardTable}


_TOPICS = Topics()
Name = Annotated[str, Field(pattern=r"^(/[A-Za-z]\w*)+$")]
"""A ROS namespace."""


class CrtkTable(Table):
    """Where arms and cameras are found on CRTK."""

    ros: Literal[1, 2] = 2
    arms: dict[str, Name] = {}
    cameras: dict[str, Name] = {}
    dialect: Literal["dvrk", "crtk-1.0", "raven"] = "dvrk"
    command: Literal["servo_jp", "move_jp"] = "servo_jp"
    loop: dict[str, float] = {}
    interface: Text = _TOPICS.interface
    peers: list[Text] = []
    domain: Annotated[int, Field(ge=0, le=MAX_DOMAIN)] | None = None
    master: Text = _TOPICS.master

    def made(self, arms: Collection[str], cameras: Collection[str], where: str) -> Topics:
        """Return the topics of these arms and cameras."""
        for kind, named, known in (("arm", self.arms, arms), ("camera", self.cameras, cameras)):
            for name in named:
                if name not in known:
                    raise UnknownName(f"{where}: {kind}", name, known)
        values = {**self.model_dump(), "peers": tuple(self.peers)}
        return Topics(**values | {"dialect": Dialect(self.dialect), "command": Command(self.command)})


class StationTable(Table):
    """A whole file."""

    name: Text
    about: Text
    arms: dict[str, ArmTable] = {}
    cameras: dict[str, CameraTable] = {}
    fixtures: dict[str, PoseTable] = {}
    registration: dict[str, Any] = {}
    min_distance_mm: float = Field(0.0, ge=0, le=100)
    crtk: CrtkTable = CrtkTable()


def station_of(values: Mapping[str, Any], where: str) -> Station:
    """Return the station that the tables of a file describe; ``where`` is the file's name in errors."""
    table = validated(StationTable, values, where)
    kind, here = table.registration.get("kind", "points"), f"{where}.registration"
    if kind not in REGISTRATIONS:
        raise UnknownName(f"{here}.kind", str(kind), REGISTRATIONS)
    return Station(
        name=table.name,
        about=table.about,
        arms={name: arm.made() for name, arm in table.arms.items()},
        cameras={name: camera.made() for name, camera in table.cameras.items()},
        T_world_fixture={name: pose.T for name, pose in table.fixtures.items()},
        registration=validated(REGISTRATIONS[kind], table.registration, here).made(),
        min_distance_m=TO_M * table.min_distance_mm,
        crtk=table.crtk.made(table.arms, table.cameras, f"{where}.crtk"),
    )
