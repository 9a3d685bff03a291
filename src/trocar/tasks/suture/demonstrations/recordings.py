"""Recorded joint states in tables, and what their numbers mean: arms, columns and units."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.geometry import SE3, SO3, shown

ANGLES = {"rad": 1.0, "deg": math.pi / 180}
LENGTHS = {"m": 1.0, "mm": 1e-3}

TABLE = ".csv"

BEYOND = 0.1
"""Share of its range by which a recorded joint may leave it: encoders drift, but wrong units exceed it by far."""

MIN_TURN_RAD, MIN_DEPTH_M = math.radians(7.0), 0.5e-3
"""A suture turns some joint, and inserts some instrument, by more than this; radians read as degrees stay below 6.3
"degrees", and metres read as mm below .3 mm."""

INSERTION = 2


@dataclass(frozen=True)
class Convention:
    """The meaning of the numbers in a set of recordings.

    Attributes:
        arms: the recorded arms, in the order of the columns; the paper recorded two.
        angles: unit of rotary joints, a key of ``ANGLES``.
        lengths: unit of the prismatic joint, or of recorded positions; a key of ``LENGTHS``.
        columns: six columns per arm, by number from 0 or by name; None: as the format defines.
        T_frame_base: pose of each arm's base (remote centre) in the frame of recorded poses, for recordings without
            joints; None: see ``jigsaws.assumed_bases``.
        R_recorded_tip: rotation of the model's tip frame (z back along the jaws, y the jaw axis) in the recorded one.
    """

    arms: tuple[ArmModel, ...]
    angles: str = "rad"
    lengths: str = "m"
    columns: tuple[int | str, ...] | None = None
    T_frame_base: tuple[SE3, ...] | None = None
    R_recorded_tip: SO3 = field(default_factory=SO3.identity)

    def __post_init__(self) -> None:
        if not self.arms:
            raise InvalidInput("the demonstrations", "name no arm", "give one or more, such as psm-classic twice")
        for what, value, choices in (("angles", self.angles, ANGLES), ("lengths", self.lengths, LENGTHS)):
            if value not in choices:
                raise UnknownName(f"the unit of {what}", value, choices)
        for what, given, needed in (
            ("columns", self.columns, self.width),
            ("bases", self.T_frame_base, len(self.arms)),
        ):
            if given is not None and len(given) != needed:
                raise InvalidInput(f"{len(given)} {what}", f"are given for {len(self.arms)} arm(s)", f"give {needed}")

    @property
    def width(self) -> int:
        """Return the total number of joints."""
        return 6 * len(self.arms)

    def joints(self, values: NDArray[np.float64], path: Path) -> NDArray[np.float64]:
        """Return recorded joint values (n, 6 arms) as (n, arms, 6) in rad and m.

        Raises:
            BadFile: there are too few rows, a value is not finite, or a value is so far outside its joint's range that
                unit, order or arm must be wrong.
        """
        if len(values) < 2:
            raise BadFile(path, f"has {len(values)} row(s) of joint states", "a recorded suture needs 2 or more")
        recorded = values.reshape(len(values), len(self.arms), 6)
        bad = np.argwhere(~np.isfinite(recorded))
        if len(bad):
            row, a, i = bad[0]
            joint = f"joint '{self.arms[a].joints[i].name}' of arm {a + 1}"
            raise BadFile(path, f"holds NaN or infinity for {joint} in row {row}", "repair the row or leave it out")
        turn, slide = ANGLES[self.angles], LENGTHS[self.lengths]
        q = recorded * np.array([turn, turn, slide, turn, turn, turn])
        for a, arm in enumerate(self.arms):
            self._check_ranges(arm, recorded[:, a], q[:, a], f"arm {a + 1}", path)
        turned_rad = float(np.ptp(np.delete(q, INSERTION, axis=-1), 0).max())
        if self.angles == "deg" and turned_rad < MIN_TURN_RAD:
            raise _wrong_unit(path, f"no angle changes by more than {shown(turned_rad, 'rad', '.2g')}", "angles", "rad")
        deepest_m = float(np.abs(q[..., INSERTION]).max())
        if self.lengths == "mm" and deepest_m < MIN_DEPTH_M:
            raise _wrong_unit(path, f"no insertion exceeds {shown(deepest_m, 'm', '.2g')}", "lengths", "m")
        return q

    def _check_ranges(
        self, arm: ArmModel, recorded: NDArray[np.float64], q: NDArray[np.float64], which: str, path: Path
    ) -> None:
        """Raise if a joint of one arm (n, 6) is far out of range, and name the unit in which it would not be."""
        slack = BEYOND * (arm.upper - arm.lower)
        excess = np.maximum(arm.lower - slack - q, q - arm.upper - slack)
        i = int(np.argmax((excess / slack).max(0)))
        row = int(np.argmax(excess[:, i]))
        if excess[row, i] <= 0:
            return
        joint, half = arm.joints[i], (arm.upper[i] - arm.lower[i]) / 2 + slack[i]
        what, unit, units = ("lengths", self.lengths, LENGTHS) if joint.prismatic else ("angles", self.angles, ANGLES)
        low, high = joint.lower / units[unit], joint.upper / units[unit]
        found = (
            f"joint '{joint.name}' of {arm.name}, {which}, reaches {recorded[row, i]:.4g} {unit} at row {row}, outside "
            f"[{low:.4g}, {high:.4g}] {unit}"
        )
        # A wrong unit puts the whole recording out of range; if only some rows are, these rows are wrong.
        if np.median(np.abs(q[:, i] - joint.middle)) > half:
            for name, scale in units.items():
                if np.abs(recorded[:, i] * scale - joint.middle).max() <= half:
                    raise _wrong_unit(path, found, what, name)
        raise BadFile(path, f": {found}", "check that row, the order of the columns, the unit and the arm")


def _wrong_unit(path: Path, found: str, what: str, unit: str) -> BadFile:
    return BadFile(path, f"seems to be in {unit}: {found}", f'set {what} = "{unit}" in its manifest')


def read_table(path: Path, convention: Convention) -> NDArray[np.float64]:
    """Return the joint values (n, 6 arms) of a table, as recorded.

    Its header calls them ``q1`` to ``q6`` or by the arm's joint names (``yaw``, ...), with a prefix per arm if there
    are several (``psm1_yaw``), unless the manifest names or numbers them; other columns, such as times, are ignored.

    Raises:
        BadFile: the file is not such a table.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error):
        raise BadFile(path, "is not a readable CSV", "export it again as UTF-8 text") from None
    header = [name.strip() for name in rows[0]] if rows else []
    if not any(name.strip("+-.eE0123456789") for name in header):
        raise BadFile(path, "has no header", "write the joints' names, or q1 to q6, into its first row")
    where = _columns(header, convention, path)
    values = np.empty((len(rows) - 1, len(where)))
    for number, row in enumerate(rows[1:]):
        try:
            values[number] = [float(row[column]) for column in where]
        except (ValueError, IndexError):
            raise BadFile(path, f"lacks a number for one of the joints in row {number}", "repair it") from None
    return values


def _columns(header: list[str], convention: Convention, path: Path) -> list[int]:
    """Return the indices of the joints' columns, in order."""
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise BadFile(path, f"has more than one column {twice!r}", "give each its own name")
    if convention.columns is not None:
        known = {name: index for index, name in enumerate(header)} | {index: index for index in range(len(header))}
        for column in convention.columns:
            if column not in known:
                raise BadFile(path, f"has no column {column!r}", f"it has {', '.join(header)}")
        return [known[column] for column in convention.columns]
    joint_names = [joint.name for joint in convention.arms[0].joints]
    for names in (joint_names, [f"q{i}" for i in range(1, 7)]):
        prefixes = [name.removesuffix(names[0]) for name in header if name.endswith(names[0])]
        prefixes = [prefix for prefix in prefixes if all(prefix + name in header for name in names)]
        if len(prefixes) == len(convention.arms):
            return [header.index(prefix + name) for prefix in prefixes for name in names]
    prefix = "" if len(convention.arms) == 1 else "psm1_"
    raise BadFile(
        path,
        f"has the columns {', '.join(header[:14])}",
        f"{len(convention.arms)} arm(s) need six each, called {prefix}{joint_names[0]}, {prefix}{joint_names[1]}, ... "
        f"or {prefix}q1 to {prefix}q6, or named in the manifest",
    )
