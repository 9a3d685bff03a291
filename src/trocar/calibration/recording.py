"""Recordings of commanded and measured joints, on which cable models are fitted."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.recording_table import read_recording_table
from trocar.errors import TrocarError
from trocar.files.archive import HEADER
from trocar.files.output import mark_zip, writing
from trocar.files.reading import UNREADABLE, parsed_json, read_arrays
from trocar.geometry import shown
from trocar.notebook import table

JOINT_NAMES = ("q1", "q2", "q3", "q4", "q5", "q6")
"""Outer yaw, outer pitch [rad], insertion [m], roll, wrist pitch, wrist yaw [rad]."""

FOLDER_FILES = (("q_cmd.npy", "q_phy.npy"), ("q_des.npy", "q_act.npy"))
"""Pairs of files (commanded, measured) that a folder may contain."""

NO_MOTION_RAD = 1e-6

MISDETECTION_RAD = 1.0
"""Cable errors of the wrist stay below .6 rad; a measurement this far from its command is a misdetected pose."""


LARGEST_RAD = 2 * np.pi
"""No joint of these arms turns further; larger values must be in degrees."""

LARGEST_M = 1.0
"""No instrument goes in further; larger values must be in millimetres."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Commands and measurements over time; all commands are kept, since models with memory need them.

    Attributes:
        q_cmd: (n, 6) commanded joints, rad and m (q3).
        q_phy: (n, 6) joints measured by fiducials; meaningless (possibly NaN) where not valid.
        valid: (n,) whether the measurement is good. Commands of bad rows are still part of the history.
        t_s: (n,) times in s, non-decreasing.
        name: name of the recording in tables.
    """

    q_cmd: NDArray[np.float64]
    q_phy: NDArray[np.float64]
    valid: NDArray[np.bool_]
    t_s: NDArray[np.float64]
    name: str = "recording"

    def __post_init__(self) -> None:
        q_cmd, q_phy = _joints(self.q_cmd, "q_cmd", self.name), _joints(self.q_phy, "q_phy", self.name)
        n = len(q_cmd)
        if len(q_phy) != n:
            raise TrocarError(f"{self.name}: q_cmd has {n} rows and q_phy {len(q_phy)}; both need one row per sample")
        if n < 2:
            raise TrocarError(f"{self.name}: a recording needs 2 rows or more, got {n}; record a longer motion")
        if not np.all(np.isfinite(q_cmd)):
            row = int(np.flatnonzero(~np.isfinite(q_cmd).all(axis=1))[0])
            raise TrocarError(
                f"{self.name}: q_cmd is not finite at row {row}; models need the whole history of commands, "
                "so repair the row or cut the recording there"
            )
        valid = _column(self.valid, n, "valid", self.name)
        t_s = _column(self.t_s, n, "t_s", self.name).astype(np.float64)
        if not np.all(np.isin(valid, (0, 1))):
            raise TrocarError(f"{self.name}: valid must hold true or false only; write 1 for good rows, else 0")
        if not np.all(np.isfinite(t_s)) or np.any(np.diff(t_s) < 0):
            raise TrocarError(f"{self.name}: t_s must be finite and not decrease; sort the rows by time")
        object.__setattr__(self, "q_cmd", q_cmd)
        object.__setattr__(self, "q_phy", q_phy)
        object.__setattr__(self, "valid", valid.astype(bool) & _plausible(q_cmd, q_phy))
        object.__setattr__(self, "t_s", t_s)

    def __len__(self) -> int:
        return len(self.q_cmd)

    def __repr__(self) -> str:
        lasts_s, valid = self.t_s[-1] - self.t_s[0], int(self.valid.sum())
        return f"<Recording {self.name!r}: {len(self)} rows over {lasts_s:.1f} s, {valid} valid>"

    def _repr_html_(self) -> str:
        error = (self.q_phy - self.q_cmd)[self.valid]
        rows = []
        for j, name in enumerate(JOINT_NAMES):
            unit = "m" if j == 2 else "rad"
            ends = [shown(value, unit) for value in (self.q_cmd[:, j].min(), self.q_cmd[:, j].max())]
            off = [shown(v, unit, ".2f") for v in (error[:, j].mean(), error[:, j].std())] if len(error) else ["", ""]
            rows.append((name, *ends, *off))
        columns = ("joint", "commanded from", "to", "measured minus commanded, mean", "its standard deviation")
        return table(self, columns, rows)

    def save(self, path: str | Path) -> Path:
        """Write the recording to an ``.npz`` file; the same recording is the same bytes.

        Raises:
            TrocarError: the name does not end in .npz, or there is something else already.
            MachineError: it cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise TrocarError(f"recording {str(path)!r} must end in .npz; choose another name")
        with writing(path, "recording") as draft:
            np.savez(draft, q_cmd=self.q_cmd, q_phy=self.q_phy, valid=self.valid, t_s=self.t_s)
            mark_zip(draft, "recording")
        return path

    def first(self, rows: int) -> Recording:
        """Return the recording's first ``rows`` rows."""
        if not 2 <= rows <= len(self):
            raise TrocarError(f"row {rows} is outside 2..{len(self)}, the rows of {self.name}")
        return Recording(self.q_cmd[:rows], self.q_phy[:rows], self.valid[:rows], self.t_s[:rows], self.name)

    def scored(self, from_row: int = 0, to_row: int | None = None) -> Recording:
        """Return the recording with all commands, but only the measurements of ``from_row <= row < to_row`` valid."""
        to_row = len(self) if to_row is None else to_row
        if not 0 <= from_row < to_row <= len(self):
            raise TrocarError(f"rows {from_row} to {to_row} are not within {self.name}, which has {len(self)} rows")
        rows = np.arange(len(self))
        part = replace(self, valid=self.valid & (rows >= from_row) & (rows < to_row))
        if not part.valid.any():
            raise TrocarError(f"{self.name}: no valid measurement in rows {from_row} to {to_row}; take more rows")
        return part


def load_recording(path: str | Path) -> Recording:
    """Return the recording in an ``.npz`` file (q_cmd, q_phy, optional valid, t_s), a CSV file, or a folder.

    The columns of a CSV file are named in :mod:`trocar.calibration.recording_table`. A folder contains ``q_cmd.npy``
    and ``q_phy.npy``, or ``q_des.npy`` (commanded) and ``q_act.npy`` (measured), and optionally ``valid.npy`` and
    ``t_s.npy``. A row also counts as bad if the measurement is not finite or a wrist angle is more than 1 rad from its
    command (a misdetection).

    Raises:
        TrocarError: the file is missing, empty, truncated, not of this form, or in other units than rad and m.
    """
    path = Path(path)
    if not path.exists():
        raise TrocarError(
            f"recording {str(path)!r} does not exist; give an .npz or .csv file, or a folder of .npy files"
        )
    arrays = _arrays(path)
    n = len(arrays["q_cmd"]) if arrays["q_cmd"].ndim else 0
    recording = Recording(
        q_cmd=arrays["q_cmd"],
        q_phy=arrays["q_phy"],
        valid=arrays.get("valid", np.ones(n, dtype=bool)),
        t_s=arrays.get("t_s", np.arange(n, dtype=np.float64)),
        name=path.stem,
    )
    _require_units(recording)
    return recording


def require_motion(recording: Recording) -> None:
    """Raise TrocarError if a wrist joint is at rest in all valid rows: nothing can be learned about its cable."""
    for joint in (3, 4, 5):
        commanded = recording.q_cmd[recording.valid, joint]
        if len(commanded) and np.ptp(commanded) < NO_MOTION_RAD:
            raise TrocarError(
                f"{recording.name}: {JOINT_NAMES[joint]} rests at {commanded[0]:.4f} rad in all {len(commanded)} valid "
                "rows, and shows nothing about its cable; give a recording in which all joints of the wrist move"
            )


def why_invalid(recording: Recording) -> str:
    """Return how many rows do not count and by which rule; empty if all count."""
    finite = np.isfinite(recording.q_phy).all(axis=1)
    plausible = _plausible(recording.q_cmd, recording.q_phy)
    reasons = {
        "have a measurement that is not a number": ~finite,
        f"are misdetected, a wrist angle {MISDETECTION_RAD:g} rad or more from its command": finite & ~plausible,
        "are marked as not valid": plausible & ~recording.valid,
    }
    return ", ".join(f"{rows.sum()} {words}" for words, rows in reasons.items() if rows.any())


def _require_units(recording: Recording) -> None:
    """Raise TrocarError if commands are so large that they must be in degrees or millimetres."""
    largest = np.abs(recording.q_cmd).max(axis=0)
    angles = np.delete(np.arange(6), 2)
    joint = angles[largest[angles].argmax()]
    if largest[joint] > LARGEST_RAD:
        raise TrocarError(
            f"{recording.name}: {JOINT_NAMES[joint]} is commanded to {largest[joint]:.1f}, which looks like degrees; "
            "give angles in rad"
        )
    if largest[2] > LARGEST_M:
        raise TrocarError(
            f"{recording.name}: q3 is commanded to {largest[2]:.1f}, which looks like millimetres; give "
            "it in m, and the joints in the order q1 to q6"
        )


def sampling_interval(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean step |dq| (6,) between the samples of a motion (n, 6), ignoring pauses."""
    steps = np.abs(np.diff(q, axis=0))
    moving = steps[steps.max(axis=1, initial=0.0) > 1e-9]
    return moving.mean(axis=0) if len(moving) else np.zeros(q.shape[1])


def _arrays(path: Path) -> dict[str, NDArray]:
    """Return the arrays in a file or a folder; the file's extension tells which format it is."""
    if path.is_dir():
        return _folder_arrays(path)
    if path.suffix == ".csv":
        return read_recording_table(path)
    if path.suffix == ".npz":
        return _npz_arrays(path)
    raise TrocarError(
        f"recording {str(path)!r} is neither an .npz or .csv file nor a folder; convert it to one of these"
    )


def _npz_arrays(path: Path) -> dict[str, NDArray]:
    try:
        arrays = read_arrays(path)
    except TrocarError:
        raise
    except (OSError, ValueError):
        raise TrocarError(f"recording {str(path)!r} is not a readable .npz of numbers; copy it again") from None
    missing = [key for key in ("q_cmd", "q_phy") if key not in arrays]
    if missing and (kind := _kind(path)):
        raise TrocarError(f"{str(path)!r} is {kind}, not a recording; give one with q_cmd and q_phy")
    if missing:
        raise TrocarError(
            f"recording {str(path)!r} lacks {' and '.join(missing)}; "
            f"it has {', '.join(filter(None, arrays)) or 'nothing'} and needs q_cmd and q_phy (optional: valid, t_s)"
        )
    return arrays


def _kind(path: Path) -> str:
    """Return in words which kind of Trocar archive a file is; empty if it is not one."""
    try:
        with zipfile.ZipFile(path) as file:
            return f"a {str(parsed_json(file.read(HEADER))['format'])[:40]!r}"
    except UNREADABLE:
        return ""


def looks_like_recording(path: str | Path) -> bool:
    """Return whether a file or folder holds commanded and measured joints, well-formed or not."""
    path = Path(path)
    if path.is_dir():
        return any((path / commanded).exists() for commanded, _ in FOLDER_FILES)
    try:
        with zipfile.ZipFile(path) as file:
            return {"q_cmd.npy", "q_phy.npy"} <= set(file.namelist())
    except (OSError, zipfile.BadZipFile, TrocarError):
        return False


def _folder_arrays(folder: Path) -> dict[str, NDArray]:
    for commanded, measured in FOLDER_FILES:
        if (folder / commanded).exists() and (folder / measured).exists():
            arrays = {"q_cmd": _load_npy(folder / commanded), "q_phy": _load_npy(folder / measured)}
            extra = {key: folder / f"{key}.npy" for key in ("valid", "t_s")}
            return arrays | {key: _load_npy(file) for key, file in extra.items() if file.exists()}
    pairs = " or ".join(f"{commanded} and {measured}" for commanded, measured in FOLDER_FILES)
    raise TrocarError(f"folder {str(folder)!r} does not hold {pairs}; give another folder, or an .npz or .csv file")


def _load_npy(path: Path) -> NDArray:
    try:
        return read_arrays(path)[""]
    except (OSError, ValueError, KeyError):
        raise TrocarError(f"{str(path)!r} is not a readable .npy of numbers; copy it again") from None


def _joints(value: NDArray, key: str, name: str) -> NDArray[np.float64]:
    value = np.asarray(value)
    if value.ndim != 2 or value.shape[1] != 6 or value.dtype.kind not in "fiu":
        raise TrocarError(f"{name}: {key} has shape {value.shape} of {value.dtype}; it needs (n, 6) numbers q1 to q6")
    return value.astype(np.float64)


def _column(value: NDArray, n: int, key: str, name: str) -> NDArray:
    value = np.asarray(value)
    if value.shape != (n,) or value.dtype.kind not in "bfiu":
        raise TrocarError(f"{name}: {key} has shape {value.shape} of {value.dtype}; it needs ({n},), one per row")
    return value


def _plausible(q_cmd: NDArray[np.float64], q_phy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which measurements (n,) are finite and not misdetections."""
    error = np.nan_to_num(np.abs(q_phy - q_cmd), nan=np.inf)
    return np.isfinite(q_phy).all(axis=1) & (error[:, 3:].max(axis=1) < MISDETECTION_RAD)
