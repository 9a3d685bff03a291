"""Recorded joint states in tables, and what their numbers mean: arms, columns and units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.files.csv_file import read_csv
from trocar.geometry import SE3, SO3, shown

ANGLES = {"rad": 1.0, "deg": math.pi / 180}
LENGTHS = {"m": 1.0, "mm": 1e-3}

BEYOND = 0.1
"""Share of its range by which a recorded joint may leave it: encoders drift, but wrong units exceed it by far."""

MIN_TURN_RAD, MIN_DEPTH_M = math.radians(7.0), 0.5e-3
"""A suture turns some joint, and inserts some instrument, by more than this; radians read as degrees stay below 6.3
"degrees", and metres read as mm below .3 mm."""

INSERTION = 2
UNITS = "the units (angles and lengths in its manifest)"


@dataclass(frozen=True)
class Convention:
    """The meaning of the numbers in a set of recordings.

    Attributes:
        arms: the recorded arms, in the order of the columns; the paper recorded two.
        angles: unit of rotary joints, a key of ``ANGLES``.
        lengths: unit of the prismatic joint, or of recorded positions; a key of ``LENGTHS``.
        columns: names of six columns per arm; None: as the arm's joints are called.
        T_frame_base: pose of each arm's base (remote centre) in the frame of recorded poses, for recordings without
            joints; None: see ``jigsaws.assumed_bases``.
        R_recorded_tip: rotation of the model's tip frame (z back along the jaws, y the jaw axis) in the recorded one.
    """

    arms: tuple[ArmModel, ...]
    angles: str = "rad"
    lengths: str = "m"
    columns: tuple[str, ...] | None = None
    T_frame_base: tuple[SE3, ...] | None = None
    R_recorded_tip: SO3 = field(default_factory=SO3.identity)

    def __post_init__(self) -> None:
        if not self.arms:
            raise InvalidInput("the demonstrations", "name no arm", "give one or more, such as psm-classic twice")
        for what, value, choices in (("angles", self.angles, ANGLES), ("lengths", self.lengths, LENGTHS)):
            if value not in choices:
                raise UnknownName(f"the unit of {what}", value, choices)
        for what, given, each in (("columns", self.columns, 6), ("bases", self.T_frame_base, 1)):
            needed = each * len(self.arms)
            if given is not None and len(given) != needed:
                raise InvalidInput(f"{len(given)} {what}", f"are given for {len(self.arms)} arm(s)", f"give {needed}")

    def joints(self, values: NDArray[np.float64], path: Path) -> NDArray[np.float64]:
        """Return recorded joint values (n, 6 arms) as (n, arms, 6) in rad and m.

        Raises:
            BadFile: there are too few rows, a value is missing, or values are so far outside their joint's range, or
                change so little, that unit, order or arm must be wrong.
        """
        if len(values) < 2:
            raise BadFile(path, f"has {len(values)} row(s) of joint states", "a recorded suture needs 2 or more")
        recorded = values.reshape(len(values), len(self.arms), 6)
        turn, slide = ANGLES[self.angles], LENGTHS[self.lengths]
        q = recorded * np.array([turn, turn, slide, turn, turn, turn])
        for number, (arm, of_arm) in enumerate(zip(self.arms, q.swapaxes(0, 1), strict=True), start=1):
            _check_ranges(arm, of_arm, number, path)
        turned_rad = float(np.ptp(np.delete(q, INSERTION, axis=-1), 0).max())
        deepest_m = float(np.abs(q[..., INSERTION]).max())
        for little, found in (
            (turned_rad < MIN_TURN_RAD, f"no angle that changes by more than {shown(turned_rad, 'rad', '.2g')}"),
            (deepest_m < MIN_DEPTH_M, f"no insertion that exceeds {shown(deepest_m, 'm', '.2g')}"),
        ):
            if little:
                raise BadFile(path, f"has {found}, too little for a suture", f"check {UNITS}")
        return q


def _check_ranges(arm: ArmModel, q: NDArray[np.float64], number: int, path: Path) -> None:
    """Raise BadFile if a joint of an arm (n, 6) is missing or far out of range."""
    slack = BEYOND * (arm.upper - arm.lower)
    inside = (q >= arm.lower - slack) & (q <= arm.upper + slack)
    if not inside.all():
        row, i = np.argwhere(~inside)[0]
        joint = arm.joints[i]
        raise BadFile(
            path,
            f"has joint '{joint.name}' of {arm.name}, arm {number}, at {joint.shown(float(q[row, i]))} in row {row}, "
            f"outside [{joint.shown(joint.lower)}, {joint.shown(joint.upper)}]",
            f"check that row, the order of the columns, the arm and {UNITS}",
        )


def read_table(path: Path, convention: Convention) -> NDArray[np.float64]:
    """Return the joint values (n, 6 arms) of a CSV file, as recorded.

    Its header calls them ``q1`` to ``q6`` or by the arm's joint names (``yaw``, ...), with a prefix per arm if there
    are several (``psm1_yaw``), unless the manifest names them; other columns, such as times, are ignored.

    Raises:
        TrocarError: the file is not such a table.
    """
    joint_names = [joint.name for joint in convention.arms[0].joints]
    prefix = "" if len(convention.arms) == 1 else "psm1_"
    header, values = read_csv(path, ",".join(prefix + name for name in joint_names))
    if convention.columns is not None:
        for column in convention.columns:
            if column not in header:
                raise BadFile(path, f"has no column {column!r}", f"it has {', '.join(header)}")
        return values[:, [header.index(column) for column in convention.columns]]
    for names in (joint_names, [f"q{i}" for i in range(1, 7)]):
        prefixes = [name.removesuffix(names[0]) for name in header if name.endswith(names[0])]
        prefixes = [each for each in prefixes if all(each + name in header for name in names)]
        if len(prefixes) == len(convention.arms):
            return values[:, [header.index(each + name) for each in prefixes for name in names]]
    raise BadFile(
        path,
        f"has the columns {', '.join(header[:14])}",
        f"{len(convention.arms)} arm(s) need six each, called {prefix}{joint_names[0]}, {prefix}{joint_names[1]}, ... "
        f"or {prefix}q1 to {prefix}q6, or named in the manifest",
    )
