"""Trials as a LeRobot data set: v3.0, or the v2.1 layout of Open-H, with one file of frames per episode.

The file of an episode's frames is written last and carries, in its footer, everything that ``meta`` says about it. So
an interrupted export continues where it stopped, and only a few trials are in memory at a time.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from trocar import __version__
from trocar.counting import Tick, untold
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval.trial import Trial
from trocar.files.output import bears, make_folder, mark_of, replacing
from trocar.learn.episode import FPS, IMAGES, PHASE, STEP, Episode, episode_of, too_short
from trocar.learn.meta import INSTRUCTION, KIND, LAYOUTS, Layout, Written, readme, write_meta
from trocar.learn.statistics import statistics
from trocar.learn.video import opened, write_video

RECORD = b"trocar"
"""Key of an episode's record in the footer of its file."""
DVRK = {"psm-classic": "dvrk", "psm-si": "dvrk"}
"""LeRobot's name of the robot, by type of arm; other types keep their own names."""


@dataclass(frozen=True)
class Exported:
    """What an export wrote, and how many trials it left out: failures, and those too short for a second frame."""

    episodes: int
    frames: int
    features: list[str]
    left_out: int
    short: int


@dataclass
class _Words:
    """Words that frames refer to by number, over all episodes."""

    tasks: dict[str, int] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)
    phases: dict[str, int] = field(default_factory=dict)


def export_lerobot(
    trials: Sequence[Trial],
    folder: str | Path,
    *,
    layout: str = "lerobot",
    commanded: bool = False,
    truth: bool = False,
    successes: bool = False,
    tick: Tick = untold,
) -> Exported:
    """Write trials of one run as a LeRobot data set, one episode each; episodes already there are kept.

    Args:
        trials: each is read once.
        folder: created if it does not exist.
        layout: ``lerobot`` (v3.0), or ``open-h`` (v2.1 with ``meta/modality.json``).
        commanded: whether actions are what was sent to the controller, instead of what the script asked for.
        truth: whether columns that only the referee knows are added.
        successes: whether trials that missed a goal are left out.
        tick: called with the progress.

    Raises:
        UnknownName: there is no such layout.
        InvalidInput: the folder holds something else, trials do not fit together, or none is left.
        MachineError: a file cannot be written.
    """
    if layout not in LAYOUTS:
        raise UnknownName("--layout", layout, LAYOUTS)
    place, how, words = _opened_folder(folder), LAYOUTS[layout], _Words()
    written: list[Written] = []
    first: tuple[Any, ...] = ()
    left_out = short = 0
    count = os.cpu_count() or 1
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[_Draft] = deque()
        frames = 0
        for number, trial in enumerate(trials):
            tick("writing episodes", number, len(trials))
            if too_short(trial):
                short += 1
                continue
            episode = episode_of(trial, commanded=commanded, truth=truth)
            if successes and not episode.about["success"]:
                left_out += 1
                continue
            draft = _draft(place, how, episode, len(written) + len(waiting), frames, words, _robot(trial))
            first = first or draft.same
            if draft.same != first:
                problem = f"differs from those before it in its {_difference(first, draft.same)}"
                remedy = "if one of them stopped before its first image, leave out trials that missed a goal"
                raise InvalidInput(f"session {trial.about['session']}, trial {trial.about['index']}", problem, remedy)
            draft.start(pool)
            waiting.append(draft)
            frames += episode.frames
            if len(waiting) > count:
                written.append(waiting.popleft().finished())
        written += [draft.finished() for draft in waiting]
    if not written and not left_out:
        raise InvalidInput("the run", "has no trial of two frames or more", "see in its report why they stopped")
    if not written:
        raise InvalidInput("the run", "has no trial that reached all its goals", "keep trials that missed a goal, too")
    _remove_others(place, how, written)
    tick("writing episodes", len(trials), len(trials))
    write_meta(place, how, written, list(words.tasks), list(words.steps), list(words.phases))
    return Exported(len(written), frames, list(written[0].features), left_out, short)


def _opened_folder(folder: str | Path) -> Path:
    """Open a folder that is empty or holds a data set that Trocar wrote, and mark it as such.

    Raises:
        BadFile: it holds something else.
    """
    place = make_folder(folder)
    card = place / "README.md"
    if any(place.iterdir()) and not (card.is_file() and bears(card, mark_of(KIND))):
        raise BadFile(place, f"holds files, but no {KIND} that Trocar wrote", "give another", kind="folder")
    (place / "meta" / "info.json").unlink(missing_ok=True)  # nobody reads a data set that is being changed
    readme(place, [], "", [])
    return place


def _robot(trial: Trial) -> str:
    names = sorted({trial.scenery.arms[arm].name for arm in trial.about["arms"]})
    return DVRK.get(names[0], "_".join(names))


def _difference(first: tuple[Any, ...], other: tuple[Any, ...]) -> str:
    return next(name for name, a, b in zip(("robot", "columns", "cameras"), first, other, strict=True) if a != b)


@dataclass(eq=False)
class _Draft:
    """An episode that is being written."""

    place: Path
    layout: Layout
    episode: Episode
    number: int
    columns: dict[str, Any]
    features: dict[str, dict[str, Any]]
    record: dict[str, Any]
    robot: str
    _videos: dict[str, Future[dict[str, Any]]] = field(default_factory=dict)
    _kept: dict[str, Any] | None = None

    @property
    def same(self) -> tuple[Any, ...]:
        """Return what all episodes of a data set have in common."""
        cameras = {key: one["shape"] for key, one in self.features.items() if one["dtype"] == "video"}
        return self.robot, {key: one["names"] for key, one in self.features.items() if key not in cameras}, cameras

    def start(self, pool: ThreadPoolExecutor) -> None:
        """Begin to write the videos, unless the whole episode is already there."""
        path = self.place / self.layout.data(self.number)
        found = _record_in(path)
        videos = {key: self.place / self.layout.video(key, self.number) for key in self.same[2]}
        if found is not None and found["record"] == self.record and all(file.is_file() for file in videos.values()):
            self._kept = found["statistics"]
            return
        path.unlink(missing_ok=True)  # this file says that the episode is complete
        for key, file in videos.items():
            make_folder(file.parent)
            taken, size = self.episode.images[key.removeprefix(IMAGES)], tuple(self.features[key]["shape"][:2])
            self._videos[key] = pool.submit(write_video, file, taken, self.episode.frames, FPS, size)

    def finished(self) -> Written:
        """Wait for the videos, write the frames, and return what ``meta`` says about the episode."""
        found = self._kept
        if found is None:
            found = {key: statistics(values) for key, values in self.columns.items() if isinstance(values, np.ndarray)}
            found |= {key: future.result() for key, future in self._videos.items()}
            path = self.place / self.layout.data(self.number)
            make_folder(path.parent)
            table = pa.table({key: _array(values) for key, values in self.columns.items()})
            table = table.replace_schema_metadata({RECORD: json.dumps({"record": self.record, "statistics": found})})
            with replacing(path) as draft:
                pq.write_table(table, draft)
        episode = self.episode
        return Written(self.number, episode.frames, episode.task, self.features, found, episode.about, self.robot)


def _digest(episode: Episode) -> str:
    """Return a digest of an episode's numbers and images: running the trial again may change it."""
    whole = hashlib.sha256()
    for name, values in episode.columns.items():
        whole.update(name.encode() + np.ascontiguousarray(values).tobytes())
    for name, taken in episode.images.items():
        for at_s, image in taken:
            whole.update(f"{name} {at_s!r}".encode() + image)
    return whole.hexdigest()[:16]


def _draft(place: Path, layout: Layout, episode: Episode, number: int, start: int, words: _Words, robot: str) -> _Draft:
    """Return an episode with the columns that every data set has, its words numbered over all episodes."""
    n = episode.frames
    columns: dict[str, Any] = {key: values.copy() for key, values in episode.columns.items()}
    for key, known, said in ((STEP, words.steps, episode.steps), (PHASE, words.phases, episode.phases)):
        columns[key] = np.array([known.setdefault(word, len(known)) for word in said])[columns[key]]
    numbers = {"frame_index": np.arange(n), "episode_index": np.full(n, number), "index": start + np.arange(n)}
    numbers["task_index"] = np.full(n, words.tasks.setdefault(episode.task, len(words.tasks)))
    features = {
        key: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": episode.names[key]}
        for key, values in columns.items()
    }
    columns["timestamp"] = (np.arange(n) / FPS).astype(np.float32)[:, None]
    columns |= {key: values.astype(np.int64)[:, None] for key, values in numbers.items()}
    for key in ("timestamp", *numbers):
        features[key] = {"dtype": str(columns[key].dtype), "shape": [1], "names": None}
    if layout.instructions:
        columns[INSTRUCTION] = [episode.steps[step] for step in episode.columns[STEP][:, 0]]
        features[INSTRUCTION] = {"dtype": "string", "shape": [1], "names": None, "description": "what is being done"}
    for camera, taken in episode.images.items():
        shape = [*opened(taken[0][1]).shape]
        features[IMAGES + camera] = {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
    record = {"trocar": __version__, "layout": layout.name, "from": start, "features": features, **episode.about}
    record["content"] = _digest(episode)
    record["words"] = [[words.steps[w] for w in episode.steps], [words.phases[w] for w in episode.phases]]
    return _Draft(place, layout, episode, number, columns, features, json.loads(json.dumps(record)), robot)


def _array(values: Any) -> pa.Array:
    """Return a column: (n, 1) numbers as plain values, (n, k) as lists of k."""
    if not isinstance(values, np.ndarray):
        return pa.array(values, pa.string())
    width = values.shape[1]
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return flat if width == 1 else pa.FixedSizeListArray.from_arrays(flat, width)


def _record_in(path: Path) -> Mapping[str, Any] | None:
    """Return the record of an episode in the footer of its file; None if there is none."""
    try:
        found = json.loads((pq.read_schema(path).metadata or {})[RECORD])
        return found if {"record", "statistics"} <= set(found) else None
    except (OSError, KeyError, ValueError):
        return None


def _remove_others(place: Path, layout: Layout, written: Sequence[Written]) -> None:
    """Remove frames and videos of an earlier export into the same folder that are no longer part of it."""
    kept = {layout.data(one.number) for one in written}
    kept |= {layout.video(key, one.number) for one in written for key in one.cameras}
    for path in (*(place / "data").rglob("*.parquet"), *(place / "videos").rglob("*.mp4")):
        if path.relative_to(place).as_posix() not in kept:
            path.unlink()
