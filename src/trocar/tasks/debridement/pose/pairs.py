"""Recordings of a gripper's pose, from a camera and from forward kinematics."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.counting import counted
from trocar.errors import BadFile, InvalidInput
from trocar.geometry import SE3, SO3

TIME_COLUMN = "t_detected_s"
POSE_COLUMNS = ("x_m", "y_m", "z_m", "yaw_deg", "pitch_deg", "roll_deg")


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Detected and kinematic poses of one gripper in the frame of its arm's base.

    Real logs have several pairs of one moment, such as two detections in one image: :func:`read_pairs` makes one pair
    of them, and says so in ``note``.

    Attributes:
        times_s: (n,) times of the detections, increasing.
        T_base_detected: (n,) poses seen by the camera.
        T_base_kinematic: (n,) poses by forward kinematics, of the same moments.
        note: what was done to the recording when it was read; empty if nothing was.
    """

    times_s: NDArray[np.float64]
    T_base_detected: SE3
    T_base_kinematic: SE3
    note: str = ""

    def __post_init__(self) -> None:
        times_s = np.asarray(self.times_s, dtype=np.float64)
        n = len(times_s) if times_s.ndim == 1 else 0
        if not n:
            raise InvalidInput(
                "times of pose pairs", f"have shape {times_s.shape}", "give (n,) with n >= 1: record some pairs"
            )
        if not np.isfinite(times_s).all():
            raise InvalidInput(
                f"the time of pair {int(np.isfinite(times_s).argmin())}", "is not finite", "remove the pair"
            )
        if np.any(np.diff(times_s) <= 0):
            row = int(np.argmax(np.diff(times_s) <= 0)) + 1
            raise InvalidInput(
                "times of pose pairs",
                f"must increase, but pair {row} at {times_s[row]} s does not follow {times_s[row - 1]} s",
                "sort the pairs by time",
            )
        for name in ("T_base_detected", "T_base_kinematic"):
            _check_poses(getattr(self, name), n, name)
        object.__setattr__(self, "times_s", times_s)

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, rows: slice) -> PosePairs:
        return PosePairs(self.times_s[rows], self.T_base_detected[rows], self.T_base_kinematic[rows])


def read_pairs(path: str | Path) -> PosePairs:
    """Return the pairs in a CSV file with a header; neighbouring pairs of one time are merged into their mean pose.

    Columns: ``t_detected_s``, then ``x_m y_m z_m yaw_deg pitch_deg roll_deg`` twice, prefixed with ``detected_`` and
    with ``kinematic_``; others are ignored. Angles turn about the base's fixed axes, roll about x first, then pitch
    about y, then yaw about z (:func:`rotation`).

    Raises:
        BadFile: the file cannot be read, is empty, lacks a column, or holds something that is not a number.
        InvalidInput: its times decrease.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadFile(path, f"cannot be read ({error})", "give a CSV file", kind="file of pose pairs") from None
    if not rows:
        raise BadFile(path, "holds no pose pairs", "give a header and one row per pair")
    times_s = _columns(rows, [TIME_COLUMN], path)[:, 0]
    detected, kinematic = (_poses(rows, source, path) for source in ("detected", "kinematic"))
    moment = np.cumsum(np.diff(times_s, prepend=np.nan) != 0) - 1
    first = np.flatnonzero(np.diff(moment, prepend=-1))
    repeats = len(times_s) - len(first)
    if not repeats:
        return PosePairs(times_s, detected, kinematic)
    note = f"{counted(repeats, 'pair')} of {len(times_s)} repeated the time of the one before: merged"
    return PosePairs(times_s[first], _means(detected, moment), _means(kinematic, moment), note)


def rotation(yaw_pitch_roll_rad: NDArray[np.float64]) -> SO3:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)`` of angles (..., 3) in rad.

    The recording does not state the order. With this one, its two sources differ by 23 deg on average, which agrees
    with the whole recording (24.5 deg), and over 5 s their rotations differ by 8 deg RMS; with yaw first it is 120 and
    43.
    """
    yaw, pitch, roll = np.moveaxis(yaw_pitch_roll_rad, -1, 0)
    return SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll)


def _means(T: SE3, group: NDArray[np.int_]) -> SE3:
    """Return the mean pose of each group of neighbouring poses: of positions, and the chordal mean of rotations."""
    sums = np.zeros((group[-1] + 1, 4, 4))
    np.add.at(sums, group, T.matrix)
    u, _, vt = np.linalg.svd(sums[:, :3, :3])
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return SE3.from_parts(SO3(u @ vt), sums[:, :3, 3] / sums[:, 3:, 3])


def _poses(rows: list[dict[str, str]], source: str, path: Path) -> SE3:
    values = _columns(rows, [f"{source}_{column}" for column in POSE_COLUMNS], path)
    return SE3.from_parts(rotation(np.radians(values[:, 3:])), values[:, :3])


def _columns(rows: list[dict[str, str]], columns: list[str], path: Path) -> NDArray[np.float64]:
    missing = [column for column in columns if column not in rows[0]]
    if missing:
        raise BadFile(path, f"lacks the columns {', '.join(missing)}", f"it has {', '.join(map(str, rows[0]))}")
    return np.array([[_number(row[column], column, i, path) for column in columns] for i, row in enumerate(rows)])


def _number(text: str | None, column: str, row: int, path: Path) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadFile(path, f"has {text!r} as {column} of pair {row}, not a finite number", "remove the pair")
    return value


def _check_poses(T: SE3, n: int, name: str) -> None:
    if T.matrix.shape != (n, 4, 4):
        raise InvalidInput(name, f"has shape {T.matrix.shape}", f"give one pose per time, ({n}, 4, 4)")
    finite = np.isfinite(T.matrix).all(axis=(1, 2))
    if not finite.all():
        raise InvalidInput(f"{name} of pair {int(finite.argmin())}", "is not finite", "remove the pair")
