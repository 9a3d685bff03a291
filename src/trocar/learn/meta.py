"""The folder ``meta`` of a data set and its card, in LeRobot's layout v3.0 and in that of Open-H (v2.1)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from trocar import __version__
from trocar.counting import counted
from trocar.files.output import make_folder, replacing, write_text
from trocar.learn.episode import ACTION, FPS, IMAGES, PHASE, STATE
from trocar.learn.poses import WIDTH
from trocar.learn.statistics import together

KIND = "data set of episodes"
CHUNK = 1000
INSTRUCTION = "instruction.text"


@dataclass(frozen=True)
class Layout:
    """Paths and format of a data set.

    Attributes:
        name: its name on the command line.
        version: version of LeRobot's format.
        data_path: template of the path of an episode's frames.
        video_path: template of the path of an episode's video of a camera.
        instructions: whether each frame says in words what is being done.
    """

    name: str
    version: str
    data_path: str
    video_path: str
    instructions: bool

    def data(self, number: int) -> str:
        """Return the path of an episode's frames."""
        return self.data_path.format(**_place(number))

    def video(self, key: str, number: int) -> str:
        """Return the path of an episode's video."""
        return self.video_path.format(video_key=key, **_place(number))


LAYOUTS = {
    "lerobot": Layout(
        "lerobot",
        "v3.0",
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        instructions=False,
    ),
    "open-h": Layout(
        "open-h",
        "v2.1",
        "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        instructions=True,
    ),
}
"""Layouts by their names on the command line."""


def _place(number: int) -> dict[str, int]:
    chunk, file = divmod(number, CHUNK)
    return {"chunk_index": chunk, "file_index": file, "episode_chunk": chunk, "episode_index": number}


@dataclass(frozen=True, eq=False)
class Written:
    """An episode whose files are written.

    Attributes:
        number: its number.
        frames: number of frames.
        task: in words.
        features: as in ``info.json``.
        statistics: of each numeric or video feature.
        about: metadata.
        robot: type of the robot.
    """

    number: int
    frames: int
    task: str
    features: Mapping[str, Mapping[str, Any]]
    statistics: Mapping[str, Any]
    about: Mapping[str, Any]
    robot: str

    @property
    def cameras(self) -> list[str]:
        """Return the keys of its videos."""
        return [key for key, one in self.features.items() if one["dtype"] == "video"]


def write_meta(
    folder: str | Path,
    layout: Layout,
    episodes: Sequence[Written],
    tasks: list[str],
    steps: list[str],
    phases: list[str],
) -> None:
    """Write everything but frames and videos; ``info.json`` last, since no reader takes a data set without it."""
    meta = make_folder(Path(folder) / "meta")
    (meta / "info.json").unlink(missing_ok=True)
    for other in (name for names in _OWN.values() for name in names if name not in _OWN[layout.name]):
        (meta / other).unlink(missing_ok=True)  # of an earlier export in another layout, it may list other episodes
    merged = {key: together([one.statistics[key] for one in episodes]) for key in episodes[0].statistics}
    if layout.instructions:
        merged[INSTRUCTION] = {"count": [sum(one.frames for one in episodes)]}
    _json(meta / "stats.json", merged)
    _json(meta / "episodes.json", {"episodes": [_listed(one, layout) for one in episodes]})
    _WRITERS[layout.name](meta, episodes, tasks, steps)
    readme(folder, episodes, layout.name, tasks)
    features = {key: dict(one) for key, one in episodes[0].features.items()}
    features[PHASE]["info"] = {"phases": phases}
    for key in episodes[0].cameras:
        height, width, channels = features[key]["shape"]
        features[key]["info"] = {
            **{"video.height": height, "video.width": width, "video.channels": channels, "video.fps": FPS},
            **{"video.codec": "h264", "video.pix_fmt": "yuv420p", "video.is_depth_map": False, "has_audio": False},
        }
    many, frames = len(episodes), sum(one.frames for one in episodes)
    info = {
        "codebase_version": layout.version,
        "robot_type": episodes[0].robot,
        "total_episodes": many,
        "total_frames": frames,
        "total_tasks": len(tasks),
        "chunks_size": CHUNK,
        "fps": FPS,
        "splits": {"train": f"0:{many}"},
        "data_path": layout.data_path,
        "video_path": layout.video_path,
        "features": features,
    }
    if layout.version == "v2.1":
        info |= {"total_videos": many * len(episodes[0].cameras), "total_chunks": -(-many // CHUNK)}
    else:
        info |= {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    _json(meta / "info.json", info)


def _listed(one: Written, layout: Layout) -> dict[str, Any]:
    """Return an episode as `lerobot-quality-gates` wants it."""
    return {
        **{"episode_id": one.number, "task": one.task, "frames": one.frames},
        **{"start_time": 0.0, "end_time": one.frames / FPS, "data_path": layout.data(one.number)},
        "video_paths": {key: layout.video(key, one.number) for key in one.cameras},
        "action_shape": one.features[ACTION]["shape"],
        "state_shape": one.features[STATE]["shape"],
    }


def _write_v30(meta: Path, episodes: Sequence[Written], tasks: list[str], steps: list[str]) -> None:
    _words(meta / "tasks.parquet", "task", tasks)
    _words(meta / "subtasks.parquet", "subtask", steps)
    rows, start = [], 0
    for one in episodes:
        place = _place(one.number)
        row: dict[str, Any] = {"episode_index": one.number, "tasks": [one.task], "length": one.frames}
        row |= {f"data/{key}": place[key] for key in ("chunk_index", "file_index")}
        row |= {"dataset_from_index": start, "dataset_to_index": start + one.frames}
        for key in one.cameras:
            row |= {f"videos/{key}/{part}": place[part] for part in ("chunk_index", "file_index")}
            row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": one.frames / FPS}
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0, **_told(one)}
        row |= {f"stats/{key}/{name}": v for key, found in one.statistics.items() for name, v in found.items()}
        rows.append(row)
        start += one.frames
    path = meta / _EPISODES
    make_folder(path.parent)
    with replacing(path) as draft:
        pq.write_table(pa.Table.from_pylist(rows), draft)


def _told(one: Written) -> dict[str, Any]:
    """Return the metadata of an episode, nested values as JSON."""
    return {key: json.dumps(value) if key in ("goals", "spans") else value for key, value in one.about.items()}


def _write_v21(meta: Path, episodes: Sequence[Written], tasks: list[str], steps: list[str]) -> None:
    _lines(meta / "tasks.jsonl", ({"task_index": k, "task": task} for k, task in enumerate(tasks)))
    _lines(meta / "subtasks.jsonl", ({"subtask_index": k, "subtask": step} for k, step in enumerate(steps)))
    _lines(
        meta / "episodes.jsonl",
        ({"episode_index": one.number, "tasks": [one.task], "length": one.frames, **one.about} for one in episodes),
    )
    stats = ({"episode_index": one.number, "stats": one.statistics} for one in episodes)
    _lines(meta / "episodes_stats.jsonl", stats)
    _json(meta / "modality.json", modality(episodes[0].features))


_WRITERS: dict[str, Callable[[Path, Sequence[Written], list[str], list[str]], None]] = {
    "lerobot": _write_v30,
    "open-h": _write_v21,
}

_EPISODES = "episodes/chunk-000/file-000.parquet"
_OWN = {
    "lerobot": ("tasks.parquet", "subtasks.parquet", _EPISODES),
    "open-h": (
        *("tasks.jsonl", "subtasks.jsonl", "episodes.jsonl", "episodes_stats.jsonl", "modality.json"),
        "README.md",
    ),
}
"""Files in ``meta`` that only one layout has."""


def modality(features: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return GR00T's description of the numbers: which are positions, orientations and jaws."""

    def parts(key: str, arm: str, start: int) -> dict[str, Any]:
        position, orientation = (start, start + 3, None), (start + 3, start + 7, "quaternion")
        ranges = {"position": position, "orientation": orientation, "jaw": (start + 7, start + WIDTH, None)}
        return {
            f"{arm}_{name}": {
                **{"start": begin, "end": end, "original_key": key, "absolute": True},
                **({"rotation_type": rotation} if rotation else {}),
            }
            for name, (begin, end, rotation) in ranges.items()
        }

    def of(key: str, mark: str) -> dict[str, Any]:
        arms = [str(name).removesuffix(f"{mark}.position.x") for name in features[key]["names"][::WIDTH]]
        return {k: v for number, arm in enumerate(arms) for k, v in parts(key, arm, WIDTH * number).items()}

    cameras = [key for key, one in features.items() if one["dtype"] == "video"]
    return {
        "state": of(STATE, "_pose"),
        "action": of(ACTION, "_sp"),
        "video": {key.removeprefix(IMAGES): {"original_key": key} for key in cameras},
        "annotation": {
            "human.task_description": {"original_key": "task_index"},
            "human.subtask_description": {"original_key": "subtask_index"},
        },
    }


def readme(folder: str | Path, episodes: Sequence[Written], layout: str, tasks: Sequence[str]) -> None:
    """Write the card, which also marks the folder as a data set that Trocar wrote."""
    frames, reached = sum(one.frames for one in episodes), sum(bool(one.about["success"]) for one in episodes)
    robot = episodes[0].robot if episodes else ""
    cameras = [key.removeprefix(IMAGES) for key in episodes[0].cameras] if episodes else []
    from_where = sorted({f"method {e.about['method']}, station {e.about['station']}" for e in episodes})
    real = bool(episodes) and episodes[0].about["collisions"] is None  # counted in simulation only
    source = "real arms, nothing synthetic" if real else "synthetic, a simulated cell"
    sent = bool(episodes) and episodes[0].about["commanded"]
    asked = "what the script asked for, before cables were compensated,"
    actions = "what was sent to the controller, corrected for the cables where a method does that," if sent else asked
    text = f"""---
tags: [LeRobot, surgical-robotics]
---
# Episodes of Trocar {__version__}

## Dataset description

{counted(len(episodes), "episode")}, {frames} frames at {FPS} Hz, {reached} episodes that reached all their goals.
Tasks: {"; ".join(tasks)}. Source: {source} ({"; ".join(from_where)}).

## Robot

`{robot}`: arms that work through a remote centre of motion. `observation.state` is what the encoders read, or
what a model of the cables made of it where the run had one; `action` {actions} by the next
frame: for each arm the tip's position (m), orientation (quaternion xyzw) and jaw (rad), in the world, by the base as
it was registered. The cables err: the tip was not where the encoders say. Columns `truth.*`, if there are any, are a
referee's; no policy may see them.

## Sensors

Encoders, read every 10 ms. Cameras: {", ".join(cameras) or "none"}; a camera takes few
images, and each is shown until the next one; before the first, the picture is black.

## Synchronization

One clock. Joints are interpolated linearly between two ticks of 10 ms; bodies (`truth.bodies`) are at the nearest one.

## Collection procedure

The method named above, session by session: each session draws cables, bases and cameras anew. `episodes` says where
each episode is from, whether it reached its goals, and what failed; `subtask_index` and `phase_index` what was being
done.

## Limitations

Scripts stand still while they look and compute. Failures are there unless they were left out.
"""
    write_text(Path(folder) / "README.md", text, KIND)
    if layout == "open-h":
        write_text(make_folder(Path(folder) / "meta") / "README.md", text, KIND)


def _words(path: Path, name: str, words: Sequence[str]) -> None:
    """Write words and their numbers, with the words as pandas' index, as LeRobot does."""
    number = f"{name}_index"
    kinds = {number: ("int64", "int64"), name: ("unicode", "object")}
    described = [
        {"name": key, "field_name": key, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}
        for key, (kind, numpy_kind) in kinds.items()
    ]
    pandas = {"index_columns": [name], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    table = pa.table({number: pa.array(range(len(words)), pa.int64()), name: pa.array(words, pa.string())})
    with replacing(path) as draft:
        pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), draft)


def _json(path: Path, values: Mapping[str, Any]) -> None:
    with replacing(path) as draft:
        draft.write_text(json.dumps(values, indent=4, allow_nan=False) + "\n", encoding="utf-8")


def _lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    with replacing(path) as draft, draft.open("w", encoding="utf-8") as file:
        file.writelines(json.dumps(row, allow_nan=False) + "\n" for row in rows)
