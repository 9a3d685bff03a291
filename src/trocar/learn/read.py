"""An episode of any LeRobot data set, v2.x or v3.x, as commands of arms; all its claims are checked."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from trocar.errors import BadFile, InvalidInput, InvalidValue
from trocar.files.reading import parsed_json, read_json
from trocar.learn.episode import ACTION, STATE
from trocar.learn.poses import WIDTH, action_names, state_names

LATE = 0.5
"""How early or late a frame may be, as a share of the frame period."""
USUAL_CHUNK = 1000
"""Episodes per chunk if a data set does not say."""
FIRST = re.compile(r"(\w+)_sp\.position\.x")
CUT = "is no Parquet file that can be read: it may be cut"


@dataclass(frozen=True, eq=False)
class Recorded:
    """What one episode recorded.

    Attributes:
        fps: frames per second.
        actions: (n, 8) set-points by arm (``trocar.learn.poses``).
        states: (n, 8) measurements by arm; empty if the data set has none.
    """

    fps: float
    actions: Mapping[str, NDArray[np.float64]]
    states: Mapping[str, NDArray[np.float64]]

    @property
    def frames(self) -> int:
        """Return the number of frames."""
        return len(next(iter(self.actions.values())))

    @property
    def digest(self) -> str:
        """Return a digest of all numbers."""
        whole = hashlib.sha256(repr(self.fps).encode())
        for of_arms in (self.actions, self.states):
            for arm, values in sorted(of_arms.items()):
                whole.update(arm.encode() + np.ascontiguousarray(values).tobytes())
        return whole.hexdigest()[:16]


def read_episode(folder: str | Path, number: int = 0) -> Recorded:
    """Return an episode of a data set whose actions are named like those of dVRKs (``psm1_sp.position.x`` ...).

    Raises:
        BadFile: it is no data set, a file is missing or cut, a column or a frame is missing, or frames do not come at
            the rate that it states.
        InvalidValue: it has no episode of this number.
        InvalidInput: its actions are not poses of arms.
    """
    folder = Path(folder)
    info = _info(folder)
    many = info["total_episodes"]
    if many < 1:
        raise BadFile(folder / "meta" / "info.json", f"says that it has {many} episodes", "fetch the data set again")
    if not 0 <= number < many:
        raise InvalidValue("--episode", number, f"give 0 to {many - 1}")
    path, length = _file_of(folder, info, number)
    table = _rows(path, number)
    if len(table) != length:
        problem = f"has {len(table)} frames of episode {number}, and its list of episodes says {length}"
        raise BadFile(path, problem, "fetch the data set again")
    fps = float(info["fps"])
    _require_rate(path, _numbers(table, "timestamp", 1, path)[:, 0], fps)
    names = _names(folder, info, ACTION)
    arms = [match[1] for name in names if (match := FIRST.fullmatch(name))]
    if not arms:
        shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        problem = f"are {shown}: no set-points of an arm such as psm1_sp.position.x"
        raise InvalidInput(f"the actions of {str(folder)!r}", problem, "give a data set with poses of dVRKs")
    actions = _of_arms(folder, names, action_names, arms, _numbers(table, ACTION, len(names), path))
    states: Mapping[str, NDArray[np.float64]] = {}
    if STATE in info["features"] and STATE in table.column_names:
        measured = _names(folder, info, STATE)
        if set(state_names(arms)) <= set(measured):
            values = _numbers(table, STATE, len(measured), path)
            states = _of_arms(folder, measured, state_names, arms, values)
    return Recorded(fps, actions, states)


def _info(folder: Path) -> dict[str, Any]:
    """Return the content of ``meta/info.json``, checked as far as it is used."""
    path = folder / "meta" / "info.json"
    if not path.is_file():
        raise BadFile(folder, "has no meta/info.json", "give the folder of a LeRobot data set", kind="folder")
    try:
        read = read_json(path)
    except (OSError, ValueError):
        raise BadFile(path, "is not readable JSON", "fetch the data set again") from None
    kinds = {"codebase_version": str, "fps": int | float, "total_episodes": int, "features": dict, "data_path": str}
    info: dict[str, Any] = {"chunks_size": USUAL_CHUNK} | read if isinstance(read, dict) else {}
    for key, kind in {**kinds, "chunks_size": int}.items():
        value = info.get(key)
        if not isinstance(value, kind):
            raise BadFile(path, f"has no {key} that can be used ({value!r})", "fetch the data set again")
    if not info["codebase_version"].startswith(("v2.", "v3.")):
        problem = f"is of format {info['codebase_version']}, and v2.0 to v3.x can be read"
        raise BadFile(path, problem, "convert it with LeRobot")
    if info["chunks_size"] < 1:
        raise BadFile(path, f"says {info['chunks_size']} episodes in a chunk", "fetch the data set again")
    if not 0 < info["fps"] < 1e4:
        raise BadFile(path, f"says {info['fps']} frames a second", "correct it, or fetch the data set again")
    return info


def _file_of(folder: Path, info: Mapping[str, Any], number: int) -> tuple[Path, int]:
    """Return the file of an episode's frames, and how many frames it should have."""
    place = {"episode_chunk": number // info["chunks_size"], "episode_index": number}
    if info["codebase_version"].startswith("v3"):
        wanted = ["episode_index", "length", "data/chunk_index", "data/file_index"]
        files = sorted((folder / "meta" / "episodes").rglob("*.parquet"))
        rows = [row for file in files for row in _rows(file, number, wanted).to_pylist()]
        listed = folder / "meta" / "episodes"
        place |= {key: row[f"data/{key}"] for row in rows for key in ("chunk_index", "file_index")}
    else:
        listed = folder / "meta" / "episodes.jsonl"
        try:
            lines = [read for read in map(_parsed, listed.read_text("utf-8", errors="replace").splitlines()) if read]
        except OSError:
            lines = []
        rows = [line for line in lines if line.get("episode_index") == number]
    if not rows:
        raise BadFile(listed, f"does not list episode {number}", "fetch the data set again")
    try:
        path = folder / info["data_path"].format(**place)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        problem = f"has a data_path {info['data_path']!r} that names no file"
        raise BadFile(folder / "meta" / "info.json", problem, "fetch the data set again") from None
    length = rows[0].get("length")
    if not isinstance(length, int):
        raise BadFile(listed, f"says that episode {number} has {length!r} frames", "fetch the data set again")
    return path, length


def _parsed(line: str) -> dict[str, Any] | None:
    try:
        found = parsed_json(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _rows(path: Path, number: int, columns: list[str] | None = None) -> pa.Table:
    """Return the rows of an episode in a file."""
    if not path.is_file():
        raise BadFile(path, "is missing", "fetch the data set again")
    try:
        has = pq.read_schema(path)
    except (pa.ArrowException, OSError, EOFError):
        raise BadFile(path, CUT, "fetch the data set again") from None
    for name in columns or ["episode_index"]:
        if name not in has.names:
            raise BadFile(
                path, f"lacks the column {name!r} (it has {', '.join(has.names)})", "fetch the data set again"
            )
        kind = has.field(name).type
        if not pa.types.is_integer(kind):
            problem = f"has a column {name!r} of type {kind}, which must be whole numbers"
            raise BadFile(path, problem, "correct it, or fetch the data set again")
    try:
        rows = [("episode_index", "=", number)]
        return pq.read_table(path, columns=columns, filters=rows, partitioning=None)  # type: ignore[arg-type]
    except (pa.ArrowException, OSError, EOFError):
        raise BadFile(path, CUT, "fetch the data set again") from None


def _numbers(table: pa.Table, key: str, width: int, path: Path) -> NDArray[np.float64]:
    """Return a column (n, width) of finite numbers."""
    if key not in table.column_names:
        has = ", ".join(table.column_names)
        raise BadFile(path, f"lacks the column {key!r} (it has {has})", "fetch the data set again")
    try:
        values = np.array(table[key].to_pylist(), dtype=np.float64).reshape(len(table), -1)
    except (ValueError, TypeError):
        values = np.empty((0, 0))
    if values.shape != (len(table), width):
        raise BadFile(path, f"has a column {key!r} that is not {width} numbers a frame", "fetch the data set again")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise BadFile(path, f"has a {key!r} that is not finite in frame {bad[0]}", "leave that episode out")
    return values


def _require_rate(path: Path, times_s: NDArray[np.float64], fps: float) -> None:
    """Raise unless frames come at the rate that the data set states."""
    late = np.abs(times_s - times_s[:1] - np.arange(len(times_s)) / fps) * fps
    if len(times_s) < 2:
        raise BadFile(path, "has fewer than two frames of it", "choose another with --episode")
    if late.max() > LATE:
        step_s = float(np.median(np.diff(times_s)))
        rate = f"{1 / step_s:.3g} Hz" if step_s > 0 else "no steady rate"
        problem = f"has frames at {rate} by their timestamps, and meta/info.json says {fps:g} Hz"
        raise BadFile(path, problem, "correct one of them")


def _names(folder: Path, info: Mapping[str, Any], key: str) -> list[str]:
    """Return the names of a feature's numbers, stored as a list, a list in a list, or lists by kind."""
    feature = info["features"].get(key)
    if not isinstance(feature, dict):
        has = ", ".join(info["features"])
        raise BadFile(folder / "meta" / "info.json", f"lacks the feature {key!r} (it has {has})", "give another")
    names = feature.get("names") or []
    if not isinstance(names, dict | list):
        raise BadFile(folder / "meta" / "info.json", f"names the numbers of {key!r} {names!r}", "give another")
    parts = list(names.values()) if isinstance(names, dict) else list(names)
    return [str(name) for part in parts for name in (part if isinstance(part, list) else [part])]


def _of_arms(
    folder: Path, names: Sequence[str], wanted: Any, arms: Sequence[str], values: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return the numbers (n, 8) of each arm, found by their names."""
    found = {}
    for arm in arms:
        missing = [name for name in wanted([arm]) if name not in names]
        if missing:
            raise InvalidInput(
                f"data set {str(folder)!r}", f"has no {missing[0]!r}", f"arm {arm!r} needs {WIDTH} numbers"
            )
        found[arm] = values[:, [names.index(name) for name in wanted([arm])]]
    return found
