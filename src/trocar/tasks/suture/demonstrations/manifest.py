"""``demonstrations.toml``: the position of each recording on the circle, and the meaning of its numbers.

``docs/demonstrations.md`` shows one.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from trocar.arms import ARMS, ArmModel
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.geometry import SE3, SO3
from trocar.lab.station_schema import Table, Text, validated

NAME = "demonstrations.toml"
KIND = "manifest of demonstrations"

Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class RecordedSuture(Table):
    """One recorded suture.

    Attributes:
        file: its recording, beside the manifest.
        theta_deg: its position on the circle, counterclockwise from x.
        rows: first row, and the row after the last; None: all.
    """

    file: Text
    theta_deg: float
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _require_rows(self) -> RecordedSuture:
        if self.rows is not None and self.rows[0] >= self.rows[1]:
            raise InvalidInput(f"rows of {self.file}", f"are {self.rows}", "give the first and the one after the last")
        return self


class Base(Table):
    """Pose of an arm's base (remote centre) in the frame of recorded poses."""

    xyz_m: Annotated[list[float], Field(min_length=3, max_length=3)]
    wxyz: Quaternion = Field([1.0, 0.0, 0.0, 0.0])


class Manifest(Table):
    """A set of recorded sutures.

    Attributes:
        source: their origin, in words.
        arms: names of the recorded arms, in the order of the columns; the paper recorded two.
        angles: unit of rotary joints.
        lengths: unit of the prismatic joint, or of recorded positions.
        columns: names of six columns per arm; None: as the arm's joints are called.
        sutures: the recorded sutures.
        bases: of the arms, for recordings without joints; None: see ``recordings.assumed_bases``.
        recorded_tip_wxyz: rotation of the model's tip frame (z back along the jaws, y the jaw axis) in the recorded
            one.
    """

    source: str = ""
    arms: Annotated[list[str], Field(min_length=1)]
    angles: Literal["rad", "deg"] = "rad"
    lengths: Literal["m", "mm"] = "m"
    columns: list[str] | None = None
    sutures: Annotated[list[RecordedSuture], Field(min_length=1)]
    bases: list[Base] | None = None
    recorded_tip_wxyz: Quaternion = Field([1.0, 0.0, 0.0, 0.0])

    @model_validator(mode="after")
    def _require_agreement(self) -> Manifest:
        for name in self.arms:
            if name not in ARMS:
                raise UnknownName("the arm", name, ARMS)
        for what, given, each in (("columns", self.columns, 6), ("bases", self.bases, 1)):
            needed = each * len(self.arms)
            if given is not None and len(given) != needed:
                raise InvalidInput(f"{len(given)} {what}", f"are given for {len(self.arms)} arm(s)", f"give {needed}")
        for wxyz in (self.recorded_tip_wxyz, *(base.wxyz for base in self.bases or ())):
            if not any(wxyz):
                raise InvalidInput("a quaternion", "is zero", "give that of a rotation")
        return self

    @property
    def models(self) -> tuple[ArmModel, ...]:
        """Return the recorded arms."""
        return tuple(ARMS[name] for name in self.arms)

    @property
    def length_m(self) -> float:
        """Return the unit of lengths."""
        return {"m": 1.0, "mm": 1e-3}[self.lengths]

    @property
    def units(self) -> NDArray[np.float64]:
        """Return the units (6,) of an arm's joints, rad and m."""
        turn = {"rad": 1.0, "deg": np.pi / 180}[self.angles]
        return np.array([turn, turn, self.length_m, turn, turn, turn])

    @property
    def T_frame_base(self) -> tuple[SE3, ...] | None:
        """Return the poses of the arms' bases in the frame of recorded poses, if they are known."""
        if self.bases is None:
            return None
        return tuple(SE3.from_parts(SO3.from_quaternion(base.wxyz), base.xyz_m) for base in self.bases)


def load_manifest(path: Path) -> Manifest:
    """Return the manifest of this file.

    Raises:
        BadFile: it is missing, broken, has unknown keys or wrong values.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadFile(path, "does not exist", f"give a folder with a {NAME}", kind=KIND) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(path, f"cannot be read as TOML: {error}", "correct it", kind=KIND) from None
    try:
        return validated(Manifest, content, "demonstrations")
    except InvalidInput as error:
        raise BadFile(path, f"is wrong: {error}", kind=KIND) from None
