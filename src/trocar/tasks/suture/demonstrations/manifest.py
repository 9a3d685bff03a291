"""``demonstrations.toml``: the position of each recording on the circle, and the meaning of its numbers.

::

    source = "expert surgeon, training phantom, 2026-03"     # shown beside every figure that depends on it
    arms = ["psm-classic", "psm-classic"]                    # the recorded arms, in the order of the columns
    angles = "deg"                                           # or "rad", the default
    lengths = "mm"                                           # or "m", the default
    columns = ["j1", "j2", "j3", "j4", "j5", "j6", ...]      # optional: the joints' columns, six per arm

    [[sutures]]
    file = "place_0_first.csv"
    theta_deg = 0                                            # counterclockwise from x of the circle
    rows = [120, 840]                                        # optional: first row, and the row after the last

    [[bases]]                                                # optional, JIGSAWS: pose of each arm's base in the
    xyz_m = [0.1, 0.0, 0.2]                                  # frame of the recorded poses
    wxyz = [1, 0, 0, 0]
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ARMS
from trocar.errors import BadFile, InvalidInput, InvalidValue
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.demonstrations.demonstrations import Demonstrations, demonstrations_from_joints
from trocar.tasks.suture.demonstrations.jigsaws import joints_from_poses, read_jigsaws
from trocar.tasks.suture.demonstrations.recordings import Convention, read_table

NAME = "demonstrations.toml"
KIND = "manifest of demonstrations"
TABLE, JIGSAWS = ".csv", ".txt"


@dataclass(frozen=True)
class RecordedSuture:
    """One recorded suture.

    Attributes:
        file: its recording.
        theta_rad: its position on the circle.
        rows: first row, and the row after the last; None: all.
    """

    file: Path
    theta_rad: float
    rows: tuple[int, int] | None = None


@dataclass(frozen=True)
class Manifest:
    """A set of recorded sutures.

    Attributes:
        source: their origin, in words.
        convention: the meaning of their numbers.
        sutures: the recorded sutures.
    """

    source: str
    convention: Convention
    sutures: tuple[RecordedSuture, ...]


def load_demonstrations(path: str | Path) -> Demonstrations:
    """Return the demonstrations of a ``demonstrations.toml``, given as that file or its folder.

    Raises:
        BadFile: the manifest or a recording is missing or broken, or a recording contradicts the manifest.
    """
    manifest = load_manifest(path)
    convention, source = manifest.convention, manifest.source
    joints: dict[int, NDArray[np.float64]] = {}
    poses: dict[int, tuple[Path, SE3]] = {}
    for index, suture in enumerate(manifest.sutures):
        found = read_recording(suture, convention)
        if isinstance(found, SE3):
            poses[index] = suture.file, found
        else:
            joints[index] = convention.joints(found, suture.file)
    if poses:
        solved, assumed = joints_from_poses(list(poses.values()), convention)
        joints |= dict(zip(poses, solved, strict=True))
        source = f"{source}; {assumed}"
    thetas = [suture.theta_rad for suture in manifest.sutures]
    return demonstrations_from_joints(thetas, [joints[index] for index in range(len(thetas))], convention.arms, source)


def read_recording(suture: RecordedSuture, convention: Convention) -> NDArray[np.float64] | SE3:
    """Return the rows of a recorded suture: joint values (n, 6 arms) as recorded or, from JIGSAWS, poses (n, arms).

    Raises:
        BadFile: the file is missing, empty or broken, or its extension or content is unknown.
    """
    path = suture.file
    if path.suffix not in (TABLE, JIGSAWS):
        raise BadFile(path, f"ends in {path.suffix!r}", f"recordings end in {TABLE} or {JIGSAWS}")
    if not path.is_file() or path.stat().st_size == 0:
        problem = "is empty" if path.is_file() else "does not exist"
        raise BadFile(path, problem, "correct its name in the manifest, or copy it again", kind="recording")
    found = read_jigsaws(path, convention) if path.suffix == JIGSAWS else read_table(path, convention)
    if suture.rows is None:
        return found
    length = len(found.matrix) if isinstance(found, SE3) else len(found)
    if suture.rows[1] > length:
        raise BadFile(path, f"has {length} rows", f"the manifest asks for {suture.rows[0]} to {suture.rows[1]}")
    return found[slice(*suture.rows)]


def load_manifest(path: str | Path) -> Manifest:
    """Return the manifest at a path, which is the file or its folder.

    Raises:
        BadFile: it is missing, broken, has unknown keys or wrong values.
    """
    path = Path(path) / NAME if Path(path).is_dir() else Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadFile(path, "does not exist", f"give a folder with a {NAME}", kind=KIND) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(path, f"cannot be read as TOML: {error}", "correct it", kind=KIND) from None
    try:
        return _manifest(content, path.parent)
    except InvalidInput as error:
        raise BadFile(path, f"is wrong: {error}", kind=KIND) from None


def _manifest(content: dict[str, Any], folder: Path) -> Manifest:
    _check_keys(content, ("source", "arms", "angles", "lengths", "columns", "sutures", "bases", "recorded_tip_wxyz"))
    arms, columns, bases = content.get("arms"), content.get("columns"), content.get("bases")
    if not isinstance(arms, list) or not all(isinstance(name, str) and name in ARMS for name in arms):
        raise InvalidValue("arms", repr(arms), f"list the recorded arms, each one of {', '.join(ARMS)}")
    words = {"source": f"demonstrations in {folder.name}", "angles": "rad", "lengths": "m"}
    words |= {key: content[key] for key in words if key in content}
    for key, word in words.items():
        if not isinstance(word, str):
            raise InvalidValue(key, repr(word), "give a word")
    if columns is not None and not (isinstance(columns, list) and all(isinstance(name, str) for name in columns)):
        raise InvalidValue("columns", repr(columns), "list names, six per arm")
    sutures = _tables(content.get("sutures", []), "sutures")
    if not sutures:
        raise InvalidInput("it", "lists no sutures", "add [[sutures]] with file and theta_deg for each recording")
    convention = Convention(
        tuple(ARMS[name] for name in arms),
        words["angles"],
        words["lengths"],
        None if columns is None else tuple(columns),
        None if bases is None else tuple(_base(base) for base in _tables(bases, "bases")),
        SO3.from_quaternion(_numbers(content.get("recorded_tip_wxyz", [1, 0, 0, 0]), 4, "recorded_tip_wxyz")),
    )
    return Manifest(words["source"], convention, tuple(_suture(entry, folder) for entry in sutures))


def _suture(entry: dict[str, Any], folder: Path) -> RecordedSuture:
    _check_keys(entry, ("file", "theta_deg", "rows"))
    file, rows = entry.get("file"), entry.get("rows")
    if not isinstance(file, str) or not file:
        raise InvalidValue("file of a suture", repr(file), "name its recording")
    theta_deg = entry.get("theta_deg")
    if not isinstance(theta_deg, int | float) or isinstance(theta_deg, bool) or not math.isfinite(theta_deg):
        raise InvalidValue(f"theta_deg of {file}", repr(theta_deg), "give its position, counterclockwise from x")
    if rows is not None:
        good = isinstance(rows, list) and len(rows) == 2 and all(type(row) is int for row in rows)
        if not (good and 0 <= rows[0] < rows[1]):
            raise InvalidValue(f"rows of {file}", repr(rows), "give the first row and the one after the last")
    return RecordedSuture(folder / file, math.radians(theta_deg), tuple(rows) if rows else None)


def _base(entry: dict[str, Any]) -> SE3:
    _check_keys(entry, ("xyz_m", "wxyz"))
    wxyz = _numbers(entry.get("wxyz", [1, 0, 0, 0]), 4, "wxyz of a base")
    return SE3.from_parts(SO3.from_quaternion(wxyz), _numbers(entry.get("xyz_m"), 3, "xyz_m of a base"))


def _tables(value: Any, name: str) -> list[dict[str, Any]]:
    if not (isinstance(value, list) and all(isinstance(entry, dict) for entry in value)):
        raise InvalidValue(name, repr(value), f"give tables [[{name}]]")
    return value


def _numbers(values: Any, count: int, what: str) -> NDArray[np.float64]:
    """Return ``count`` finite numbers; four are a quaternion, and not all zero."""
    good = isinstance(values, list) and len(values) == count and all(type(v) in (int, float) for v in values)
    if not good or not np.isfinite(values).all() or (count == 4 and not np.any(values)):
        raise InvalidValue(what, repr(values), f"give {count} finite numbers")
    return np.array(values, dtype=np.float64)


def _check_keys(entry: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in entry:
        if key not in known:
            raise InvalidInput("it", f"has the unknown key {key!r}", f"known are {', '.join(known)}")
