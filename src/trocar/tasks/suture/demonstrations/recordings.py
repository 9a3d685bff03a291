"""Read ``demonstrations.toml`` and its recordings: tables of joint states (.csv) or JIGSAWS texts of poses (.txt).

A JIGSAWS text has 76 columns at 30 Hz and no header; joints are solved from its poses.
"""

from __future__ import annotations

import math
import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from trocar.arms import ARMS, ArmModel, fk, ik_unbounded
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.files.csv_file import read_csv
from trocar.geometry import SE3, SO3, shown
from trocar.lab.station_schema import Table, Text, validated
from trocar.tasks.suture.demonstrations import NAME

KIND = "manifest of demonstrations"
BEYOND = 0.1
"""A recorded joint may leave its range by this share of it: encoders drift, but wrong units exceed this by far."""
MIN_TURN_RAD, MIN_DEPTH_M = math.radians(7.0), 0.5e-3
"""Every suture turns some joint, and inserts some instrument, by more than this; radians read as degrees stay below 6.3
"degrees", and metres read as mm below .3 mm."""
INSERTION = 2
UNITS = "the units (angles and lengths in its manifest)"

COLUMNS = 76
SLAVES = (38, 57)
"""First column of the left slave, then of the right: position m (3), rotation row by row (9), velocity (3), angular
velocity (3, unreliable), gripper (1); the masters come before (the JIGSAWS data set)."""
MIN_SPREAD_M = 0.3e-3
"""A suture's poses spread over more than this; metres read as mm spread over less."""
SKEWED = 0.2
"""A matrix that differs by more than this from the nearest rotation, in the largest entry, is not a rotation."""
MIN_REAL_SHARE = 0.5
"""Share of a recording's poses for which the arm must have a solution; with fewer the bases are wrong."""

Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class RecordedSuture(Table):
    """One recorded suture: file, position on the circle, and its rows (the first, and the one after the last)."""

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
        bases: bases of the arms, for recordings without joints; None: see ``assumed_bases``.
        recorded_tip_wxyz: rotation of the model's tip frame (z back along the jaws, y the jaw axis) in the recorded
            one.
    """

    source: str = ""
    arms: Annotated[list[str], Field(min_length=1)]
    angles: Literal["rad", "deg"] = "rad"
    lengths: Literal["m", "mm"] = "m"
    sutures: Annotated[list[RecordedSuture], Field(min_length=1)]
    bases: list[Base] | None = None
    recorded_tip_wxyz: Quaternion = Field([1.0, 0.0, 0.0, 0.0])

    @model_validator(mode="after")
    def _require_agreement(self) -> Manifest:
        for name in self.arms:
            if name not in ARMS:
                raise UnknownName("the arm", name, ARMS)
        if self.bases is not None and len(self.bases) != (count := len(self.arms)):
            raise InvalidInput(f"{len(self.bases)} bases", f"are given for {count} arm(s)", f"give {count}")
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


def read_joints(path: Path, rows: slice, manifest: Manifest) -> NDArray[np.float64]:
    """Return rows of the joint states (n, arms, 6) of a CSV file, in rad and m.

    Raises:
        BadFile: the file is not such a table, there are too few rows, a value is missing, or values are so far outside
            their joint's range, or change so little, that unit, order or arm must be wrong.
    """
    values = _columns(path, manifest)[rows]
    if len(values) < 2:
        raise BadFile(path, f"has {len(values)} row(s) of joint states", "a recorded suture needs 2 or more")
    q = values.reshape(len(values), len(manifest.arms), 6) * manifest.units
    for number, (arm, of_arm) in enumerate(zip(manifest.models, q.swapaxes(0, 1), strict=True), start=1):
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


def _columns(path: Path, manifest: Manifest) -> NDArray[np.float64]:
    """Return the joints' columns (n, 6 arms) of a CSV file, as recorded; other columns, such as times, are ignored.

    The header calls them ``q1`` to ``q6`` or by the arm's joint names, with a prefix per arm if there are several.
    """
    arms = manifest.models
    joint_names = [joint.name for joint in arms[0].joints]
    prefix = "" if len(arms) == 1 else "psm1_"
    header, values = read_csv(path, ",".join(prefix + name for name in joint_names))
    for names in (joint_names, [f"q{i}" for i in range(1, 7)]):
        prefixes = [name.removesuffix(names[0]) for name in header if name.endswith(names[0])]
        prefixes = [each for each in prefixes if all(each + name in header for name in names)]
        if len(prefixes) == len(arms):
            return values[:, [header.index(each + name) for each in prefixes for name in names]]
    called = f"called {prefix}{joint_names[0]}, {prefix}{joint_names[1]}, ... or {prefix}q1 to {prefix}q6"
    raise BadFile(path, f"has the columns {', '.join(header[:14])}", f"{len(arms)} arm(s) need six each, {called}")


def read_jigsaws(path: Path, rows: slice, manifest: Manifest) -> SE3:
    """Return rows of the poses (n, 2) of the slaves' tips, left and right, in the frame of the recording.

    Recorded rotations are rounded; each is replaced by the nearest rotation.

    Raises:
        BadFile: the file is not such a text, its lengths are in another unit than the manifest says, or the manifest
            does not have two arms.
    """
    if len(manifest.arms) != len(SLAVES):
        raise BadFile(
            path, f"records two slaves, but the manifest has {len(manifest.arms)} arm(s)", "name two, left and right"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is reported below
            values = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError):
        problem = f"is not a text of {COLUMNS} numbers per row, as JIGSAWS writes it"
        raise BadFile(path, problem, "copy it again") from None
    if values.shape[1] != COLUMNS or len(values) < 2:
        raise BadFile(path, f"has {values.shape[0]} row(s) of {values.shape[1]} columns", f"it needs 2 of {COLUMNS}")
    used = np.stack([values[:, start : start + 12] for start in SLAVES], 1)
    bad = np.flatnonzero(~np.isfinite(used).all((1, 2)))
    if len(bad):
        raise BadFile(path, f"holds NaN or infinity for a slave's pose in row {bad[0]}", "leave the row out")
    rotations, off = nearest_rotations(used[..., 3:].reshape(*used.shape[:2], 3, 3))
    if off.max() > SKEWED:
        row = int(np.argmax(off.max(1)))
        raise BadFile(path, f"has a rotation in row {row} that is {off.max():.2g} away from any: not JIGSAWS' columns")
    places_m = used[..., :3] * manifest.length_m
    spread_m = np.linalg.norm(np.ptp(places_m, axis=0), axis=-1)
    reach_m = 2 * np.array([arm.upper[INSERTION] + arm.tip_length_m for arm in manifest.models])
    if (spread_m > reach_m).any() or spread_m.max() < MIN_SPREAD_M:
        found = f"has poses whose positions spread over {' and '.join(shown(each, 'm', '.3g') for each in spread_m)}"
        raise BadFile(
            path, f"{found}; a suture takes {shown(MIN_SPREAD_M, 'm')} to {shown(reach_m.min(), 'm')}", f"check {UNITS}"
        )
    return SE3.from_parts(rotations, places_m)[rows]


def nearest_rotations(matrices: NDArray[np.float64]) -> tuple[SO3, NDArray[np.float64]]:
    """Return the rotations nearest to matrices (..., 3, 3), and how far (...,) their largest entry moved."""
    U, _, Vt = np.linalg.svd(matrices)
    sign = np.ones((*matrices.shape[:-2], 1, 3))
    sign[..., 0, 2] = np.linalg.det(U @ Vt)
    R = (U * sign) @ Vt
    return SO3(R), np.abs(R - matrices).max((-1, -2))


def joints_from_poses(
    recordings: Sequence[tuple[Path, SE3]], manifest: Manifest
) -> tuple[list[NDArray[np.float64]], str]:
    """Return joints (n, arms, 6) of recorded poses (n, arms), and what was assumed, in words.

    The recordings of a set share the bases. Poses without a solution are left out.

    Raises:
        BadFile: most poses of a recording cannot be reached from the bases.
    """
    arms = manifest.models
    turn = SE3.from_parts(SO3.from_quaternion(manifest.recorded_tip_wxyz))
    tips = [(path, recording @ turn) for path, recording in recordings]
    bases = [SE3.from_parts(SO3.from_quaternion(base.wxyz), base.xyz_m) for base in manifest.bases or ()]
    bases = bases or assumed_bases([tip for _, tip in tips], arms)
    lower, upper = (np.stack([getattr(arm, end) for arm in arms]) for end in ("lower", "upper"))
    joints, outside, lost, total = [], 0, 0, 0
    for path, tip in tips:
        q = np.stack([ik_unbounded(arm, bases[a].inverse() @ tip[:, a]) for a, arm in enumerate(arms)], 1)
        real = np.asarray(np.isfinite(q).all((1, 2)))
        if real.mean() < MIN_REAL_SHARE or real.sum() < 2:
            raise BadFile(
                path,
                f"has poses of which {100 * (1 - real.mean()):.0f} % cannot be reached from the arms' bases",
                "correct the bases, or the frame of the recorded tip, in the manifest",
            )
        outside += int(((q[real] < lower) | (q[real] > upper)).any((1, 2)).sum())
        lost, total = lost + int((~real).sum()), total + real.size
        joints.append(q[real])
    given = (
        "bases as given in the manifest"
        if manifest.bases
        else "assumed bases, from which each arm's mean recorded pose is that at the middle of its joints' ranges"
    )
    return joints, (
        f"joints by inverse kinematics from Cartesian poses, {given}; {100 * outside / total:.0f} % of the poses then "
        f"lie outside the joints' limits, {100 * lost / total:.0f} % have no solution"
    )


def assumed_bases(tips: list[SE3], arms: Sequence[ArmModel]) -> list[SE3]:
    """Return a plausible base for each arm: one from which it works in the middle of its joints' ranges.

    Poses of the tip do not determine the remote centre (the inverse kinematics has solutions for any), so it is assumed
    such that the mean pose of the tip over all recordings (n, arms) is that at the middle of the joints' ranges.
    """
    bases = []
    for a, arm in enumerate(arms):
        matrices = np.concatenate([tip.matrix[:, a] for tip in tips])
        rotation, _ = nearest_rotations(matrices[:, :3, :3].mean(0))
        mean = SE3.from_parts(rotation, matrices[:, :3, 3].mean(0))
        bases.append(mean @ fk(arm, arm.middle).inverse())
    return bases
