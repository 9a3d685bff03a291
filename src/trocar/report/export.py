"""Trials as flat tables, for any program that reads CSV or Parquet."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk
from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.eval.turns import turn_at, turns_of
from trocar.extras import how_to_install
from trocar.files.output import MADE_BY, make_folder, mark_of, write_table, writing
from trocar.geometry import steady

Kind = Literal["text", "integer", "number", "truth"]


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        name: in the table's first line, with the unit for numbers.
        about: what it means.
        kind: of its values.
        unit: of its values; empty if they have none.
    """

    name: str
    about: str
    kind: Kind = "text"
    unit: str = ""


@dataclass(frozen=True, eq=False)
class FlatTable:
    """Columns with their values.

    Attributes:
        name: what one row is, in the plural.
        columns: in order.
        values: of each column, all of the same length; None for a missing value.
    """

    name: str
    columns: tuple[Column, ...]
    values: tuple[Sequence[Any] | NDArray[Any], ...]

    @staticmethod
    def of_rows(name: str, columns: Sequence[Column], rows: Sequence[Sequence[Any]]) -> FlatTable:
        """Return the table of these rows."""
        return FlatTable(name, tuple(columns), tuple(zip(*rows, strict=True)) if rows else ((),) * len(columns))

    def write_csv(self, path: str | Path) -> None:
        """Write it as CSV: empty cells are missing values, booleans ``true`` or ``false``, numbers have nine digits."""
        cells = [
            ["" if value is None else _SHOWN[column.kind](value) for value in values]
            for column, values in zip(self.columns, self.values, strict=True)
        ]
        write_table(path, [column.name for column in self.columns], zip(*cells, strict=True))

    def write_parquet(self, path: str | Path) -> None:
        """Write it as Parquet, with Trocar's mark in the metadata; raises as ``writing`` does."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        types = {"text": pa.string(), "integer": pa.int64(), "number": pa.float64(), "truth": pa.bool_()}
        arrays = [pa.array(v, types[column.kind]) for column, v in zip(self.columns, self.values, strict=True)]
        filled = pa.Table.from_arrays(arrays, names=[column.name for column in self.columns])
        kind = f"table of {self.name}"
        with writing(path, kind) as draft, pq.ParquetWriter(draft, filled.schema, store_schema=False) as file:
            file.write_table(filled)
            file.add_key_value_metadata({MADE_BY: mark_of(kind)})  # at the end, where the mark is looked for


_SHOWN: dict[Kind, Callable[[Any], str]] = {
    "text": str,
    "integer": str,
    "number": lambda value: f"{value:.9g}",
    "truth": lambda value: str(bool(value)).lower(),
}
FORMATS: dict[str, Callable[[FlatTable, Path], None]] = {
    "csv": FlatTable.write_csv,
    "parquet": FlatTable.write_parquet,
}


def kind_of(values: Sequence[Any]) -> Kind:
    """Return the type that fits all of these values."""
    there = [value for value in values if value is not None]
    truths = [isinstance(value, bool | np.bool_) for value in there]
    if not there or (any(truths) and not all(truths)):
        return "text"
    kinds: list[tuple[Kind, Any]] = [("truth", bool | np.bool_), ("integer", int), ("number", int | float)]
    for kind, types in kinds:
        if all(isinstance(value, types) for value in there):
            return kind
    return "text"


_PLACE = (
    Column("session", "number of the session, from 0 on", "integer"),
    Column("trial", "number of the trial in its session, from 0 on", "integer"),
)
_END = Column("end_s", "when it ended, on the trial's clock", "number", "s")
_DURATION = Column("duration_s", "how long it took on the trial's clock", "number", "s")
_TIMES = Column("start_s", "when it began, on the trial's clock", "number", "s"), _END, _DURATION
_OF_RUN = {
    "task": "what was to be done",
    "variant": "which variant of it",
    "method": "how it was done",
    "model": "cable model of methods that compensate",
    "planner": "of the motions",
    "station": "where",
}
"""Keys of a trial's ``about`` that describe its run, with their meaning."""

TABLES: dict[str, tuple[Column, ...]] = {
    "trials": (
        *_PLACE,
        *(Column(name, about) for name, about in _OF_RUN.items()),
        Column("seed", "of everything random", "integer"),
        Column("fingerprint", "of the run's configuration"),
        Column("arms", "that work, separated by spaces"),
        Column("ended", "done, or what stopped the script"),
        Column("reason", "why, if it was stopped"),
        _DURATION,
        Column("attempted", "goals that count", "integer"),
        Column("succeeded", "goals that were reached", "integer"),
        Column("collisions", "that the referee saw", "integer"),
    ),
    "goals": (
        *_PLACE,
        Column("goal", "number of the goal among those of the task, from 0 on", "integer"),
        Column("arms", "that worked on it, in order, separated by spaces"),
        Column("attempted", "whether it counts in the denominator", "truth"),
        Column("succeeded", "whether it was reached, as the referee saw it", "truth"),
        Column("outcome", "DONE, or the name of what went wrong"),
        Column("reason", "a sentence, if there is one"),
        *_TIMES,
    ),
    "spans": (
        *_PLACE,
        Column("arm", "whose time"),
        Column("span", "what it did: capture, perception, planning, motion, jaw, settling, ..."),
        Column("goal", "number of the goal that the arm was busy with when it began, if any", "integer"),
        *_TIMES,
    ),
    "events": (
        *_PLACE,
        Column("time_s", "on the trial's clock", "number", "s"),
        Column("event", "what the script noted; the end of a goal is named after it, such as transfer"),
        Column("arm", "whose, if given"),
        Column("goal", "which, if given", "integer"),
        Column("outcome", "as the script saw it, if given; the referee's is in goals"),
        Column("reason", "if given"),
        Column("more", "everything else that was noted, as one JSON object"),
    ),
    "collisions": (
        *_PLACE,
        Column("time_s", "when it began, on the trial's clock", "number", "s"),
        _END,
        Column("arm", "whose"),
        Column("what", "arm, or what it held"),
        Column("against", "the other arm, or what stood there"),
        Column("force_n", "largest force", "number", "N"),
        *(Column(f"{axis}_m", "where that was, in the world", "number", "m") for axis in "xyz"),
    ),
    "columns": (
        Column("table", "name of the table"),
        Column("column", "name of the column"),
        Column("unit", "of its numbers"),
        Column("about", "what it means"),
    ),
}
"""The columns of each table; a task's own scores add further ones to ``goals``."""


@dataclass(frozen=True)
class Written:
    """One table that was written: its file, the number of its rows, the names of its columns."""

    path: Path
    rows: int
    columns: tuple[str, ...]


def export_trials(
    trials: Sequence[Trial],
    folder: str | Path,
    format: str = "csv",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Written]:
    """Write trials of one run as flat tables, and return what was written.

    ``trials``, ``goals``, ``spans``, ``events`` and ``collisions`` have the rows of all trials; what was sampled at 100
    Hz is in ``samples``, one table per trial; ``columns`` says what each column means.

    Args:
        trials: each is read once.
        folder: made if it is not there.
        format: a key of :data:`FORMATS`.
        progress: called with the number of trials done and of all.

    Raises:
        TrocarError: the format is unknown or needs what is not installed, or a file is in the way.
        MachineError: a file cannot be written.
    """
    if format not in FORMATS:
        raise InvalidInput(f"format {format!r}", "is unknown", f"choose one of {', '.join(FORMATS)}")
    if format == "parquet":
        _require_parquet()
    folder = make_folder(folder)
    sampled = make_folder(folder / "samples")
    told: dict[tuple[str, str], Column] = {}

    def write(table: FlatTable, path: Path) -> Written:
        told.update({(table.name, column.name): column for column in table.columns})
        FORMATS[format](table, path)
        return Written(path, len(table.values[0]), tuple(column.name for column in table.columns))

    rows: dict[str, list[tuple[Any, ...]]] = {name: [] for name in TABLES if name != "columns"}
    own: list[dict[str, Any]] = []
    samples = []
    for number, trial in enumerate(trials):
        progress(number, len(trials))
        for name, more in _rows_of(trial).items():
            rows[name] += more
        own += [
            {re.sub(r"\W", "_", f"{trial.goal_noun}_{key}"): score[key] for key in score if key not in _SCORED}
            for score in trial.scores
        ]
        name = f"session_{trial.about['session']:02d}_trial_{trial.about['index']:03d}"
        samples.append(write(samples_of(trial), sampled / f"{name}.{format}"))
    tables = {name: FlatTable.of_rows(name, TABLES[name], of_table) for name, of_table in rows.items()}
    tables["goals"] = _with_own(tables["goals"], own)
    written = [write(table, folder / f"{name}.{format}") for name, table in tables.items()]
    about = [(table, column.name, column.unit, column.about) for (table, _), column in told.items()]
    return [
        *written,
        *samples,
        write(FlatTable.of_rows("columns", TABLES["columns"], about), folder / f"columns.{format}"),
    ]


def _require_parquet() -> None:
    try:
        import pyarrow  # noqa: F401 - an extra, of 150 MB
    except ImportError:
        raise InvalidInput("--format parquet", "needs pyarrow", f"{how_to_install('parquet')}, or use csv") from None


_SCORED = ("attempted", "succeeded", "failure", "reason", "start_s", "end_s")
"""Fields of a score that every task has."""


def _rows_of(trial: Trial) -> dict[str, list[tuple[Any, ...]]]:
    """Return the rows of one trial in all tables that are not sampled."""
    about, turns = trial.about, turns_of(trial)
    place = about["session"], about["index"]
    counts = [score for score in trial.scores if score["attempted"]]
    how = (about["seed"], about["fingerprint"], " ".join(about["arms"]), trial.ended, trial.reason, trial.duration_s)
    hits = None if trial.on_robot else len(trial.collisions)
    came_to = len(counts), sum(score["succeeded"] for score in counts), hits
    rows: dict[str, list[tuple[Any, ...]]] = {
        "trials": [(*place, *(about[name] for name in _OF_RUN), *how, *came_to)],
        "goals": [],
        "spans": [],
        "events": [(*place, *_of_event(event)) for event in trial.events],
        "collisions": [
            (*place, *(hit[key] for key in ("time_s", "end_s", "arm", "what", "against", "force_n")), *hit["p_world_m"])
            for hit in trial.collisions
        ],
    }
    for number, score in enumerate(trial.scores):
        busy = [turn.arm for turn in sorted(turns, key=lambda turn: turn.start_s) if turn.goal == number]
        arms = " ".join(map(str, dict.fromkeys(about["arms"] if None in busy else busy)))
        judged = score["attempted"], score["succeeded"], "DONE" if score["succeeded"] else score["failure"]
        times = score["start_s"], score["end_s"], score["end_s"] - score["start_s"]
        rows["goals"].append((*place, number, arms, *judged, score["reason"], *times))
    for span in trial.spans:
        turn = turn_at(turns, span.arm, span.start_s)
        times = span.start_s, span.end_s, span.end_s - span.start_s
        rows["spans"].append((*place, span.arm, span.name, None if turn is None else turn.goal, *times))
    return rows


def _of_event(event: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the cells of an event; values that do not have a column's type are listed with everything else."""
    kinds = {"arm": str, "goal": int, "outcome": str, "reason": str}
    flat = {key: event[key] for key, kind in kinds.items() if isinstance(event.get(key), kind)}
    more = {key: value for key, value in event.items() if key not in ("name", "time_s", *flat)}
    text = json.dumps(more, sort_keys=True) if more else None
    return (event["time_s"], event["name"], *(flat.get(key) for key in kinds), text)


def _with_own(goals: FlatTable, own: Sequence[Mapping[str, Any]]) -> FlatTable:
    """Return the table of goals with a column for each field of the task's own score."""
    columns, values = list(goals.columns), list(goals.values)
    for name in dict.fromkeys(name for score in own for name in score):
        told = [score.get(name) for score in own]
        kind = kind_of(told)
        columns.append(Column(name, "of the task's own score", kind))
        as_it_is = kind != "text"
        values.append([v if as_it_is or v is None or isinstance(v, str) else json.dumps(v) for v in told])
    return FlatTable(goals.name, tuple(columns), tuple(values))


_KINDS = {
    "desired": "as the script asked for",
    "commanded": "as it was sent to the controller, corrected for the cables",
    "measured": "as the encoders read it",
    "true": "as it really was, which only the referee knows",
}


def samples_of(trial: Trial) -> FlatTable:
    """Return a row for each tick: time, each arm's joints, jaw and tip of all kinds, and each free body's pose.

    Tips are in the world: the true one by the arm's true base, all others by its registered base.
    """
    times = trial.times_s
    found: list[tuple[Column, NDArray[Any]]] = [
        (column, np.full(len(times), trial.about[key]))
        for column, key in zip(_PLACE, ("session", "index"), strict=True)
    ]
    found.append((Column("time_s", "on the trial's clock", "number", "s"), times))
    for name, arm in trial.scenery.arms.items():
        for kind in _KINDS:
            rows = trial.arrays.get(f"{kind}_{name}")
            if rows is not None:
                found += _of_arm(trial, name, arm, kind, rows.astype(np.float64))
    for key, rows in trial.arrays.items():
        if key.startswith("body_"):
            body = key.removeprefix("body_")
            found += _pose(body, f"of {body} in the world", rows.astype(np.float64))
    return FlatTable("samples", tuple(column for column, _ in found), tuple(values for _, values in found))


def _of_arm(
    trial: Trial, name: str, arm: ArmModel, kind: str, rows: NDArray[np.float64]
) -> Iterator[tuple[Column, NDArray[Any]]]:
    """Yield the columns of one arm's joints (n, 7), jaw and tip of one kind."""
    for number, joint in enumerate(arm.joints):
        column = f"{name}_q{number + 1}_{kind}_{joint.unit}"
        yield Column(column, f"{joint.name} of {name}, {_KINDS[kind]}", "number", joint.unit), rows[:, number]
    yield Column(f"{name}_jaw_{kind}_rad", f"jaws of {name}, {_KINDS[kind]}", "number", "rad"), rows[:, 6]
    scenery = trial.scenery
    base = scenery.T_world_base[name] if kind == "true" else scenery.T_world_base_registered[name]
    tip = base @ fk(arm, rows[:, :6])
    seven = np.column_stack([tip.translation_m, steady(tip.rotation.as_quaternion())])
    yield from _pose(f"{name}_tip_{kind}", f"of the tip of {name} in the world, {_KINDS[kind]}", seven)


def _pose(name: str, about: str, rows: NDArray[np.float64]) -> Iterator[tuple[Column, NDArray[Any]]]:
    """Yield the columns of poses (n, 7): position m, quaternion wxyz."""
    for place, axis in enumerate("xyz"):
        yield Column(f"{name}_{axis}_m", f"{axis} {about}", "number", "m"), rows[:, place]
    for place, part in enumerate("wxyz", 3):
        yield Column(f"{name}_q{part}", f"orientation {about}, quaternion", "number"), rows[:, place]
