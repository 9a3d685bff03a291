"""Recordings of commanded and measured joints, to which cable models are fitted, and their files."""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import BadFile, InvalidInput, TrocarError
from trocar.files.archive import HEADER
from trocar.files.csv_file import TIMES, read_csv
from trocar.files.output import mark_zip, writing
from trocar.files.reading import UNREADABLE, parsed_json, read_arrays
from trocar.geometry import shown
from trocar.geometry.arrays import Array
from trocar.notebook import table

JOINT_NAMES = ("q1", "q2", "q3", "q4", "q5", "q6")
"""Outer yaw, outer pitch [rad], insertion [m], roll, wrist pitch, wrist yaw [rad]."""
JOINT_UNITS = ("rad", "rad", "m", "rad", "rad", "rad")
FOLDER_FILES = (("q_cmd.npy", "q_phy.npy"), ("q_des.npy", "q_act.npy"))
"""Pairs of files (commanded, measured) that a folder may contain."""

BAGS, BAG_METADATA = (".bag", ".db3", ".mcap"), "metadata.yaml"
"""Suffixes of ROS bags, and the file that marks a folder as one."""

COMMANDED, MEASURED = (
    tuple(f"{name}_{kind}_{unit}" for name, unit in zip(JOINT_NAMES, JOINT_UNITS, strict=True))
    for kind in ("commanded", "measured")
)
VALID = "valid"  # CSV column: 1 for good rows, else 0
EXAMPLE = f"time_s,{COMMANDED[0]},...,{COMMANDED[-1]},{MEASURED[0]},...,{MEASURED[-1]}"
NO_MOTION_RAD = 1e-6
MISDETECTION_RAD = 1.0
"""Cable errors of the wrist stay below .6 rad; a measurement this far from its command is a misdetected pose."""
LARGEST = {"rad": (2 * np.pi, "degrees"), "m": (1.0, "millimetres")}
"""The largest command that an arm can have in each unit, and the unit that a larger value suggests."""


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

    q_cmd: Array
    q_phy: Array
    valid: NDArray[np.bool_]
    t_s: Array
    name: str = "recording"

    def __post_init__(self) -> None:
        def refuse(problem: str, remedy: str) -> InvalidInput:
            return InvalidInput(self.name, problem, remedy)

        def checked(key: str, kinds: str, shape: tuple[int, ...], wanted: str) -> Array:
            value = np.asarray(getattr(self, key))
            if value.shape != shape or value.dtype.kind not in kinds:
                raise refuse(f"has {key} of shape {value.shape} of {value.dtype}", f"it needs {wanted}")
            return value.astype(np.float64)

        lengths = {key: len(getattr(self, key)) if np.ndim(getattr(self, key)) else 0 for key in ("q_cmd", "q_phy")}
        q_cmd, q_phy = (checked(key, "fiu", (n, 6), "(n, 6) numbers q1 to q6") for key, n in lengths.items())
        n = len(q_cmd)
        if len(q_phy) != n:
            raise refuse(f"has {n} rows of q_cmd and {len(q_phy)} of q_phy", "both need one row per sample")
        if n < 2:
            raise refuse(f"has {n} rows", "a recording needs 2 or more: record a longer motion")
        if not np.all(np.isfinite(q_cmd)):
            row = int(np.flatnonzero(~np.isfinite(q_cmd).all(axis=1))[0])
            remedy = "models need the whole history of commands, so repair the row or cut the recording there"
            raise refuse(f"has a q_cmd that is not finite at row {row}", remedy)
        valid, t_s = (checked(key, "bfiu", (n,), f"({n},) numbers, one per row") for key in ("valid", "t_s"))
        if not np.all(np.isin(valid, (0, 1))):
            raise refuse("has other values of valid than true or false", "write 1 for good rows, else 0")
        if not np.all(np.isfinite(t_s)) or np.any(np.diff(t_s) < 0):
            raise refuse("has times t_s that are not finite or decrease", "sort the rows by time")
        plausible = valid.astype(bool) & _plausible(q_cmd, q_phy)
        for key, value in (("q_cmd", q_cmd), ("q_phy", q_phy), ("valid", plausible), ("t_s", t_s)):
            object.__setattr__(self, key, value)

    def __len__(self) -> int:
        return len(self.q_cmd)

    def __repr__(self) -> str:
        lasts_s, valid = self.t_s[-1] - self.t_s[0], int(self.valid.sum())
        return f"<Recording {self.name!r}: {len(self)} rows over {lasts_s:.1f} s, {valid} valid>"

    def _repr_html_(self) -> str:
        error, rows = self.errors[self.valid], []
        for j, (name, unit) in enumerate(zip(JOINT_NAMES, JOINT_UNITS, strict=True)):
            ends = [shown(value, unit) for value in (self.q_cmd[:, j].min(), self.q_cmd[:, j].max())]
            off = [shown(v, unit, ".2f") for v in (error[:, j].mean(), error[:, j].std())] if len(error) else ["", ""]
            rows.append((name, *ends, *off))
        columns = ("joint", "commanded from", "to", "measured minus commanded, mean", "its standard deviation")
        return table(self, columns, rows)

    @property
    def errors(self) -> Array:
        """Return measured minus commanded joints (n, 6), rad and m; meaningless where not valid."""
        return self.q_phy - self.q_cmd

    def save(self, path: str | Path) -> Path:
        """Write the recording to an ``.npz`` file; the same recording gives the same bytes.

        Raises:
            BadFile: the name does not end in .npz, or a file of another kind has this name.
            MachineError: the file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise BadFile(path, "does not end in .npz", "choose another name", kind="recording")
        with writing(path, "recording") as draft:
            np.savez(draft, q_cmd=self.q_cmd, q_phy=self.q_phy, valid=self.valid, t_s=self.t_s)
            mark_zip(draft, "recording")
        return path

    def first(self, rows: int) -> Recording:
        """Return the recording's first ``rows`` rows."""
        if not 2 <= rows <= len(self):
            raise InvalidInput(f"row {rows}", f"is outside 2..{len(self)}, the rows of {self.name}")
        return Recording(self.q_cmd[:rows], self.q_phy[:rows], self.valid[:rows], self.t_s[:rows], self.name)

    def scored(self, from_row: int = 0) -> Recording:
        """Return the recording with only the measurements from ``from_row`` on valid; all commands are kept."""
        if not 0 <= from_row < len(self):
            raise InvalidInput(f"row {from_row}", f"is not within the {len(self)} rows of {self.name}")
        part = replace(self, valid=self.valid & (np.arange(len(self)) >= from_row))
        if not part.valid.any():
            problem = f"has no valid measurement from row {from_row} on"
            raise InvalidInput(self.name, problem, "take more rows")
        return part

    def require_motion(self) -> None:
        """Raise InvalidInput if a wrist joint rests in all valid rows, which show nothing about its cable."""
        for joint in (3, 4, 5):
            q = self.q_cmd[self.valid, joint]
            if len(q) and np.ptp(q) < NO_MOTION_RAD:
                rests = f"which rests at {q[0]:.4f} rad in all {len(q)} valid rows"
                problem = f"shows nothing about the cable of {JOINT_NAMES[joint]}, {rests}"
                raise InvalidInput(self.name, problem, "give a recording in which all joints of the wrist move")

    def require_units(self) -> None:
        """Raise InvalidInput if commands are so large that they must be in degrees or millimetres."""
        for name, unit, largest in zip(JOINT_NAMES, JOINT_UNITS, np.abs(self.q_cmd).max(axis=0), strict=True):
            most, looks = LARGEST[unit]
            if largest > most:
                problem = f"has commands of {name} up to {largest:.1f}, which looks like {looks}"
                raise InvalidInput(self.name, problem, f"give {unit}, and the joints in the order q1 to q6")

    def why_invalid(self) -> str:
        """Return how many rows are not valid and why; empty if all are valid."""
        finite = np.isfinite(self.q_phy).all(axis=1)
        plausible = _plausible(self.q_cmd, self.q_phy)
        reasons = {
            "have a measurement that is not a number": ~finite,
            f"are misdetected, a wrist angle {MISDETECTION_RAD:g} rad or more from its command": finite & ~plausible,
            "are marked as not valid": plausible & ~self.valid,
        }
        return ", ".join(f"{rows.sum()} {words}" for words, rows in reasons.items() if rows.any())


def load_recording(path: str | Path) -> Recording:
    """Return the recording in an ``.npz`` file (q_cmd, q_phy, optional valid, t_s), a CSV file, or a folder.

    A CSV file has the columns :data:`COMMANDED` and :data:`MEASURED`, in any order, and optionally one of times and
    ``valid`` (1 or 0); an empty cell is a missing measurement. A folder contains ``q_cmd.npy`` and ``q_phy.npy``, or
    ``q_des.npy`` (commanded) and ``q_act.npy`` (measured), and optionally ``valid.npy`` and ``t_s.npy``. A row is also
    invalid if its measurement is not finite, or a misdetection: a wrist angle 1 rad or more from its command.

    Raises:
        BadFile: the file is missing, empty, truncated, not of this form, or in other units than rad and m.
    """
    path = Path(path)
    if path.suffix in BAGS or (path / BAG_METADATA).is_file():
        raise _bad(path, "is a bag of ROS", "make a recording of it with trocar recording import")
    if path.is_dir():
        arrays = _folder_arrays(path)
    elif not path.exists():
        raise _bad(path, "does not exist", "give an .npz or .csv file, or a folder of .npy files")
    elif path.suffix == ".csv":
        arrays = _csv_arrays(path)
    elif path.suffix == ".npz":
        arrays = _npz_arrays(path)
    else:
        raise _bad(path, "is neither an .npz or .csv file nor a folder", "convert it to one of these")
    n = len(arrays["q_cmd"]) if arrays["q_cmd"].ndim else 0
    arrays = {"valid": np.ones(n, dtype=bool), "t_s": np.arange(n)} | arrays
    try:
        recording = Recording(arrays["q_cmd"], arrays["q_phy"], arrays["valid"], arrays["t_s"], path.stem)
        recording.require_units()
    except InvalidInput as error:
        raise _bad(path, error.problem, error.remedy) from None
    return recording


def looks_like_recording(path: str | Path) -> bool:
    """Return whether a file or folder holds commanded and measured joints, well-formed or not."""
    path = Path(path)
    if path.is_dir():
        return any((path / commanded).exists() for commanded, _ in FOLDER_FILES)
    try:
        with zipfile.ZipFile(path) as file:
            return {"q_cmd.npy", "q_phy.npy"} <= set(file.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _plausible(q_cmd: Array, q_phy: Array) -> NDArray[np.bool_]:
    """Return which measurements (n,) are finite and not misdetections."""
    error = np.nan_to_num(np.abs(q_phy - q_cmd), nan=np.inf)
    return np.isfinite(q_phy).all(axis=1) & (error[:, 3:].max(axis=1) < MISDETECTION_RAD)


def _bad(path: Path, problem: str, remedy: str) -> BadFile:
    return BadFile(path, problem, remedy, kind="recording")


def _npz_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        arrays = read_arrays(path)
    except TrocarError:
        raise
    except (OSError, ValueError):
        raise _bad(path, "is not a readable .npz of numbers", "copy it again") from None
    missing = [key for key in ("q_cmd", "q_phy") if key not in arrays]
    if missing and (kind := _archive_kind(path)):
        raise BadFile(path, f"is a {kind!r}, not a recording", "give one with q_cmd and q_phy")
    if missing:
        has = ", ".join(filter(None, arrays)) or "nothing"
        problem = f"lacks {' and '.join(missing)}, it has {has}"
        raise _bad(path, problem, "it needs q_cmd and q_phy (optional: valid, t_s)")
    return arrays


def _archive_kind(path: Path) -> str:
    """Return which kind of Trocar archive a file is; empty if it is not one."""
    try:
        with zipfile.ZipFile(path) as file:
            return str(parsed_json(file.read(HEADER))["format"])[:40]
    except UNREADABLE:
        return ""


def _folder_arrays(folder: Path) -> dict[str, NDArray[Any]]:
    for pair in FOLDER_FILES:
        if all((folder / name).exists() for name in pair):
            files = dict(zip(("q_cmd", "q_phy", "valid", "t_s"), (*pair, "valid.npy", "t_s.npy"), strict=True))
            return {key: _npy_array(folder / name) for key, name in files.items() if (folder / name).exists()}
    pairs = " or ".join(f"{commanded} and {measured}" for commanded, measured in FOLDER_FILES)
    raise BadFile(folder, f"does not hold {pairs}", "give another folder, or an .npz or .csv file", kind="folder")


def _npy_array(path: Path) -> NDArray[Any]:
    try:
        return read_arrays(path)[""]
    except (OSError, ValueError, KeyError):
        raise BadFile(path, "is not a readable .npy of numbers", "copy it again") from None


def _csv_arrays(path: Path) -> dict[str, NDArray[Any]]:
    names, rows = read_csv(path, EXAMPLE)
    times = [name for name in names if name in TIMES]
    _require_columns(path, names, times)
    found: dict[str, NDArray[Any]] = {
        key: rows[:, [names.index(name) for name in columns]]
        for key, columns in (("q_cmd", COMMANDED), ("q_phy", MEASURED))
    }
    missing = np.argwhere(np.isnan(found["q_cmd"]))
    if len(missing):
        row, joint = missing[0]
        remedy = "models need the whole history of commands, so fill it in, or cut the recording there"
        raise _bad(path, f"has no number under {COMMANDED[joint]!r} in row {row + 2}", remedy)
    extra = {"t_s": times[0] if times else "", "valid": VALID}
    return found | {key: rows[:, names.index(name)] for key, name in extra.items() if name in names}


def _require_columns(path: Path, names: list[str], times: list[str]) -> None:
    """Raise BadFile unless these are the columns of a recording."""
    known = {*COMMANDED, *MEASURED, VALID}
    for name in names:
        other = re.fullmatch(r"(q[1-6]_(?:commanded|measured))_?(\w*)", name)
        if other and name not in known:
            meant = next(column for column in known if column.startswith(other[1]))
            unit = f"in {other[2]!r}" if other[2] else "without a unit"
            wanted = meant.rpartition("_")[2]
            raise _bad(path, f"has a column {name!r} {unit}", f"give it in {wanted} and call it {meant!r}")
    missing = [name for name in (*COMMANDED, *MEASURED) if name not in names]
    if missing:
        problem = f"lacks column {', '.join(missing)}, it has {', '.join(names)[:200]}"
        raise _bad(path, problem, f"it needs {EXAMPLE}")
    strange = [name for name in names if name not in known and name not in times]
    if strange or len(times) > 1:
        allowed = f"one of times ({' or '.join(TIMES[:2])}) and {VALID!r} (1 or 0)"
        remedy = f"besides the twelve of the joints it may have {allowed}, so leave it out"
        raise _bad(path, f"has a column {(strange or times)[-1]!r} too many", remedy)
