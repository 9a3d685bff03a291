"""``demonstrations.toml``: the position of each recording on the circle, and the meaning of its numbers.

::

    source = "expert surgeon, training phantom, 2026-03"     # shown beside every figure that depends on it
    arms = ["psm-classic", "psm-classic"]                    # the recorded arms, in the order of the columns
    angles = "deg"                                           # or "rad", the default
    lengths = "mm"                                           # or "m", the default
    columns = [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12]        # optional: the joints' columns, by number or name
    state = "observation.state"                              # optional: the column of a parquet file

    [[sutures]]
    file = "place_0_first.csv"
    theta_deg = 0                                            # counterclockwise from x of the circle
    rows = [120, 840]                                        # optional: first row, and the row after the last
    episode = 3                                              # optional: of a parquet file

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
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.demonstrations.convention import Convention
from trocar.tasks.suture.demonstrations.demonstrations import Demonstrations, demonstrations_from_joints
from trocar.tasks.suture.demonstrations.poses import joints_from_poses
from trocar.tasks.suture.demonstrations.readers import read_recording

NAME = "demonstrations.toml"
KEYS = {"source", "arms", "angles", "lengths", "columns", "state", "sutures", "bases", "recorded_tip_wxyz"}
SUTURE_KEYS = {"file", "theta_deg", "rows", "episode"}
BASE_KEYS = {"xyz_m", "wxyz"}
DEFAULTS = {"angles": "rad", "lengths": "m", "state": "observation.state"}


@dataclass(frozen=True)
class RecordedSuture:
    """One recorded suture.

    Attributes:
        file: its recording.
        theta_rad: its position on the circle.
        rows: first row, and the row after the last; None: all.
        episode: of a parquet file; None: the only one.
    """

    file: Path
    theta_rad: float
    rows: tuple[int, int] | None = None
    episode: int | None = None


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
        TrocarError: the manifest or a recording is missing or broken, or a recording contradicts the manifest.
    """
    manifest = load_manifest(path)
    convention, joints, poses = manifest.convention, {}, {}
    for index, suture in enumerate(manifest.sutures):
        found = read_recording(suture.file, convention, suture.episode)
        length = len(found.matrix) if isinstance(found, SE3) else len(found)
        rows = slice(*suture.rows) if suture.rows else slice(None)
        if suture.rows and suture.rows[1] > length:
            raise TrocarError(
                f"{suture.file}: the manifest asks for rows {suture.rows[0]} to {suture.rows[1]}; it has {length} rows"
            )
        if isinstance(found, SE3):
            poses[index] = found[rows]
        else:
            joints[index] = convention.joints(found[rows], str(suture.file))
    source = manifest.source
    if poses:
        names = [str(manifest.sutures[index].file) for index in poses]
        solved, assumed = joints_from_poses(list(poses.values()), convention, names)
        joints |= dict(zip(poses, solved, strict=True))
        source = f"{source}; {assumed}"
    thetas = [suture.theta_rad for suture in manifest.sutures]
    recordings = [joints[index] for index in range(len(thetas))]
    return demonstrations_from_joints(thetas, recordings, convention.arms, source)


def load_manifest(path: str | Path) -> Manifest:
    """Return the manifest at a path, which is the file or its folder.

    Raises:
        TrocarError: it is missing, broken, has unknown keys or wrong values.
    """
    path = Path(path)
    if path.is_dir():
        path = path / NAME
    if not path.is_file():
        raise TrocarError(
            f"demonstrations {str(path)!r} do not exist; give a folder with a {NAME} that names the recordings"
        )
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise TrocarError(f"{str(path)!r} cannot be read as TOML: {error}; correct it") from None
    where = str(path)
    _check_keys(content, KEYS, where)
    sutures = content.get("sutures", [])
    if not (isinstance(sutures, list) and sutures and all(isinstance(entry, dict) for entry in sutures)):
        raise TrocarError(f"{where} lists no sutures; add [[sutures]] with file and theta_deg for each recording")
    source = content.get("source", f"demonstrations in {path.parent.name}")
    if not isinstance(source, str):
        raise TrocarError(f"{where}: source is {source!r}; say in words where the recordings come from")
    found = tuple(_suture(entry, path.parent, f"{where}, suture {i + 1}") for i, entry in enumerate(sutures))
    return Manifest(source, _convention(content, where), found)


def _convention(content: dict[str, Any], where: str) -> Convention:
    arms = content.get("arms")
    if not isinstance(arms, list) or not all(isinstance(name, str) and name in ARMS for name in arms):
        raise TrocarError(f"{where}: arms is {arms!r}; list the recorded arms, each one of {', '.join(ARMS)}")
    words = {key: content.get(key, default) for key, default in DEFAULTS.items()}
    for key, value in words.items():
        if not isinstance(value, str):
            raise TrocarError(f"{where}: {key} is {value!r}; give a word, such as {DEFAULTS[key]!r}")
    columns = content.get("columns")
    if columns is not None:
        kinds = {type(column) for column in columns} if isinstance(columns, list) else set()
        if kinds not in ({int}, {str}):
            raise TrocarError(f"{where}: columns is {columns!r}; list numbers from 0, or names, six per arm")
        columns = tuple(columns)
    bases = content.get("bases")
    if bases is not None:
        if not (isinstance(bases, list) and all(isinstance(base, dict) for base in bases)):
            raise TrocarError(f"{where}: bases is {bases!r}; add [[bases]] with xyz_m and wxyz for each arm")
        bases = tuple(_base(base, f"{where}, base {i + 1}") for i, base in enumerate(bases))
    tip = _numbers(content.get("recorded_tip_wxyz", [1, 0, 0, 0]), 4, f"{where}: recorded_tip_wxyz")
    try:
        return Convention(
            tuple(ARMS[name] for name in arms),
            columns=columns,
            T_frame_base=bases,
            R_recorded_tip=SO3.from_quaternion(tip),
            **words,
        )
    except TrocarError as error:
        raise TrocarError(f"{where}: {error}") from None


def _suture(entry: dict[str, Any], folder: Path, where: str) -> RecordedSuture:
    _check_keys(entry, SUTURE_KEYS, where)
    file, theta, rows, episode = (entry.get(key) for key in ("file", "theta_deg", "rows", "episode"))
    if not isinstance(file, str) or not file:
        raise TrocarError(f"{where} has the file {file!r}; name its recording")
    if not isinstance(theta, int | float) or isinstance(theta, bool) or not math.isfinite(theta):
        raise TrocarError(
            f"{where} ({file}) has theta_deg = {theta!r}; give its position on the circle in degrees, "
            "counterclockwise from x"
        )
    if rows is not None and not (
        isinstance(rows, list) and len(rows) == 2 and all(type(row) is int for row in rows) and 0 <= rows[0] < rows[1]
    ):
        raise TrocarError(f"{where} ({file}) has rows = {rows!r}; give the first row and the one after the last")
    if episode is not None and type(episode) is not int:
        raise TrocarError(f"{where} ({file}) has episode = {episode!r}; give a whole number")
    return RecordedSuture(folder / file, math.radians(theta), tuple(rows) if rows else None, episode)


def _base(entry: dict[str, Any], where: str) -> SE3:
    _check_keys(entry, BASE_KEYS, where)
    xyz, wxyz = _numbers(entry.get("xyz_m"), 3, f"{where}: xyz_m"), entry.get("wxyz", [1, 0, 0, 0])
    return SE3.from_parts(SO3.from_quaternion(_numbers(wxyz, 4, f"{where}: wxyz")), xyz)


def _numbers(values: Any, count: int, where: str) -> NDArray[np.float64]:
    """Return ``count`` finite numbers (four are a quaternion, and not all zero), or raise TrocarError."""
    good = isinstance(values, list) and len(values) == count and all(type(v) in (int, float) for v in values)
    if not good or not np.isfinite(values).all() or (count == 4 and not np.any(values)):
        raise TrocarError(f"{where} is {values!r}; give {count} finite numbers")
    return np.array(values, dtype=np.float64)


def _check_keys(entry: dict[str, Any], known: set[str], where: str) -> None:
    unknown = [key for key in entry if key not in known]
    if unknown:
        raise TrocarError(f"{where} has the unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")
