"""A trial as a table: its columns, its samples, and notes on each column."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk
from trocar.eval.trial import Trial
from trocar.files.output import write_table
from trocar.geometry import SE3
from trocar.report.timechart import turn_at, turns_of

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

    def __len__(self) -> int:
        return len(self.values[0])

    @staticmethod
    def of_rows(name: str, columns: Sequence[Column], rows: Sequence[Sequence[Any]]) -> FlatTable:
        """Return the table of these rows."""
        values = tuple(list(column) for column in zip(*rows, strict=True)) if rows else ([],) * len(columns)
        return FlatTable(name, tuple(columns), values)

    def write_csv(self, path: str | Path) -> Path:
        """Write it as CSV: empty cells are missing values, booleans ``true`` or ``false``, numbers have nine digits."""
        cells = [
            list(map(_SHOWN[column.kind], values)) for column, values in zip(self.columns, self.values, strict=True)
        ]
        return write_table(path, [column.name for column in self.columns], zip(*cells, strict=True))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.9g}"


def _text(value: object) -> str:
    return "" if value is None else str(value)


def _truth(value: bool | None) -> str:
    return "" if value is None else str(bool(value)).lower()


_SHOWN: dict[Kind, Callable[[Any], str]] = {"text": _text, "integer": _text, "number": _number, "truth": _truth}


def kind_of(values: Sequence[Any]) -> Kind:
    """Return the type that fits all of these values."""
    there = [value for value in values if value is not None]
    if there and all(isinstance(value, bool | np.bool_) for value in there):
        return "truth"
    if there and all(isinstance(value, int) and not isinstance(value, bool) for value in there):
        return "integer"
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in there)
    return "number" if there and numbers else "text"


PLACE = (
    Column("session", "number of the session, from 0 on", "integer"),
    Column("trial", "number of the trial in its session, from 0 on", "integer"),
)
START, END = (
    Column("start_s", "when it began, on the trial's clock", "number", "s"),
    Column("end_s", "when it ended, on the trial's clock", "number", "s"),
)
DURATION = Column("duration_s", "how long it took on the trial's clock", "number", "s")
GOAL = Column("goal", "number of the goal among those of the task, from 0 on", "integer")
OF_RUN = {
    "task": "what was to be done",
    "variant": "which variant of it",
    "method": "how it was done",
    "model": "cable model of methods that compensate",
    "planner": "of the motions",
    "station": "where",
}
"""Keys of a trial's ``about`` that describe its run, with their meaning."""

TRIALS = (
    *PLACE,
    *(Column(name, about) for name, about in OF_RUN.items()),
    Column("seed", "of everything random", "integer"),
    Column("fingerprint", "of the run's configuration"),
    Column("arms", "that work, separated by spaces"),
    Column("ended", "done, or what stopped the script"),
    Column("reason", "why, if it was stopped"),
    DURATION,
    Column("attempted", "goals that count", "integer"),
    Column("succeeded", "goals that were reached", "integer"),
    Column("collisions", "that the referee saw", "integer"),
)
GOALS = (
    *PLACE,
    GOAL,
    Column("arms", "that worked on it, in order, separated by spaces"),
    Column("attempted", "whether it counts in the denominator", "truth"),
    Column("succeeded", "whether it was reached, as the referee saw it", "truth"),
    Column("outcome", "DONE, or the name of what went wrong"),
    Column("reason", "a sentence, if there is one"),
    START,
    END,
    DURATION,
)
SPANS = (
    *PLACE,
    Column("arm", "whose time"),
    Column("span", "what it did: capture, perception, planning, motion, jaw, settling, ..."),
    Column("goal", "number of the goal that the arm was busy with when it began, if any", "integer"),
    START,
    END,
    DURATION,
)
EVENTS = (
    *PLACE,
    Column("time_s", "on the trial's clock", "number", "s"),
    Column("event", "what the script noted; the end of a goal is named after it, such as transfer"),
    Column("arm", "whose, if given"),
    Column("goal", "which, if given", "integer"),
    Column("outcome", "as the script saw it, if given; the referee's is in goals"),
    Column("reason", "if given"),
    Column("more", "everything else that was noted, as one JSON object"),
)
COLLISIONS = (
    *PLACE,
    Column("time_s", "when it began, on the trial's clock", "number", "s"),
    END,
    Column("arm", "whose"),
    Column("what", "arm, or what it held"),
    Column("against", "the other arm, or what stood there"),
    Column("force_n", "largest force", "number", "N"),
    *(Column(f"{axis}_m", "where that was, in the world", "number", "m") for axis in "xyz"),
)
SCORED = ("attempted", "succeeded", "failure", "reason", "start_s", "end_s")


@dataclass
class Notes:
    """Rows of all tables except the sampled ones; trials are added one by one."""

    _rows: dict[str, list[tuple[Any, ...]]] = field(
        default_factory=lambda: {name: [] for name in ("trials", "goals", "spans", "events", "collisions")}
    )
    _own: list[dict[str, Any]] = field(default_factory=list)

    def add(self, trial: Trial) -> None:
        """Add the rows of one trial."""
        about, turns, rows = trial.about, turns_of(trial), self._rows
        place = about["session"], about["index"]
        rows["trials"].append((*place, *_of_trial(trial)))
        for number, score in enumerate(trial.scores):
            busy = [turn.arm for turn in sorted(turns, key=lambda turn: turn.start_s) if turn.goal == number]
            arms = dict.fromkeys(about["arms"] if None in busy else busy)
            outcome = "DONE" if score["succeeded"] else score["failure"]
            times = score["start_s"], score["end_s"], score["end_s"] - score["start_s"]
            judged = score["attempted"], score["succeeded"], outcome, score["reason"]
            rows["goals"].append((*place, number, " ".join(map(str, arms)), *judged, *times))
            self._own.append({_own_name(trial, key): score[key] for key in score if key not in SCORED})
        for span in trial.spans:
            turn = turn_at(turns, span.arm, span.start_s)
            times = span.start_s, span.end_s, span.end_s - span.start_s
            rows["spans"].append((*place, span.arm, span.name, None if turn is None else turn.goal, *times))
        rows["events"] += [(*place, *_of_event(event)) for event in trial.events]
        for hit in trial.collisions:
            told = (hit[key] for key in ("time_s", "end_s", "arm", "what", "against", "force_n"))
            rows["collisions"].append((*place, *told, *hit["p_world_m"]))

    def tables(self) -> list[FlatTable]:
        """Return the tables of all trials that were added."""
        columns = {"trials": TRIALS, "goals": GOALS, "spans": SPANS, "events": EVENTS, "collisions": COLLISIONS}
        found = [FlatTable.of_rows(name, columns[name], rows) for name, rows in self._rows.items()]
        return [_with_own(table, self._own) if table.name == "goals" else table for table in found]


def _of_trial(trial: Trial) -> tuple[Any, ...]:
    about, counted = trial.about, [score for score in trial.scores if score["attempted"]]
    return (
        *(about[name] for name in OF_RUN),
        about["seed"],
        about["fingerprint"],
        " ".join(about["arms"]),
        trial.ended,
        trial.reason,
        trial.duration_s,
        len(counted),
        sum(score["succeeded"] for score in counted),
        len(trial.collisions),
    )


def _of_event(event: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the cells of an event; values that do not have a column's type are listed with everything else."""
    kinds = {"arm": str, "goal": int, "outcome": str, "reason": str}
    flat = {key: event[key] for key, kind in kinds.items() if isinstance(event.get(key), kind)}
    more = {key: value for key, value in event.items() if key not in ("name", "time_s", *flat)}
    text = json.dumps(more, sort_keys=True) if more else None
    return (event["time_s"], event["name"], *(flat.get(key) for key in kinds), text)


def _own_name(trial: Trial, key: str) -> str:
    """Return the column of a field of the task's own score, such as ``transfer_source``."""
    return re.sub(r"\W", "_", f"{trial.goal_noun}_{key}")


def _with_own(goals: FlatTable, own: Sequence[Mapping[str, Any]]) -> FlatTable:
    """Return the table of goals with a column for each field of the task's own score."""
    names = dict.fromkeys(name for score in own for name in score)
    columns, values = list(goals.columns), list(goals.values)
    for name in names:
        told = [score.get(name) for score in own]
        kind = kind_of(told)
        columns.append(Column(name, "of the task's own score", kind))
        values.append([_as_text(value) for value in told] if kind == "text" else told)
    return FlatTable(goals.name, tuple(columns), tuple(values))


def _as_text(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else json.dumps(value)


KINDS = {
    "desired": "as the script asked for",
    "commanded": "as it was sent to the controller, corrected for the cables",
    "measured": "as the encoders read it",
    "true": "as it really was, which only the referee knows",
}
QUATERNION = ("qw", "qx", "qy", "qz")
Values = tuple[Column, NDArray[Any]]


def samples_of(trial: Trial) -> FlatTable:
    """Return a row for each tick: time; of each arm joints, jaw and tip of all kinds; pose of each free body.

    Tips are in the world: the true one by the arm's true base, all others by the base as it was registered.
    """
    times = trial.times_s
    found: list[Values] = [
        (column, np.full(len(times), trial.about[key])) for column, key in zip(PLACE, ("session", "index"), strict=True)
    ]
    found.append((Column("time_s", "on the trial's clock", "number", "s"), times))
    for name, arm in trial.scenery.arms.items():
        for kind in KINDS:
            rows = trial.arrays.get(f"{kind}_{name}")
            if rows is not None:
                found += _of_arm(trial, name, arm, kind, rows.astype(np.float64))
    for key, rows in trial.arrays.items():
        if key.startswith("body_"):
            body = key.removeprefix("body_")
            found += _pose(body, f"of {body} in the world", rows.astype(np.float64))
    return FlatTable("samples", tuple(column for column, _ in found), tuple(values for _, values in found))


def _of_arm(trial: Trial, name: str, arm: ArmModel, kind: str, rows: NDArray[np.float64]) -> Iterator[Values]:
    """Yield the columns of one arm's joints (n, 7), jaw and tip of one kind."""
    for number, joint in enumerate(arm.joints):
        column = f"{name}_q{number + 1}_{kind}_{joint.unit}"
        yield Column(column, f"{joint.name} of {name}, {KINDS[kind]}", "number", joint.unit), rows[:, number]
    yield Column(f"{name}_jaw_{kind}_rad", f"jaws of {name}, {KINDS[kind]}", "number", "rad"), rows[:, 6]
    scenery = trial.scenery
    base = scenery.T_world_base[name] if kind == "true" else scenery.T_world_base_registered[name]
    tip = base @ fk(arm, rows[:, :6])
    seven = np.column_stack([tip.translation_m, _quaternions(tip)])
    yield from _pose(f"{name}_tip_{kind}", f"of the tip of {name} in the world, {KINDS[kind]}", seven)


def _pose(name: str, about: str, rows: NDArray[np.float64]) -> Iterator[Values]:
    """Yield the columns of poses (n, 7): position m, quaternion wxyz."""
    for place, axis in enumerate("xyz"):
        yield Column(f"{name}_{axis}_m", f"{axis} {about}", "number", "m"), rows[:, place]
    for place, part in enumerate(QUATERNION, 3):
        yield Column(f"{name}_{part}", f"orientation {about}, quaternion", "number"), rows[:, place]


def _quaternions(poses: SE3) -> NDArray[np.float64]:
    """Return quaternions (n, 4) wxyz that do not jump from one row to the next."""
    found = poses.rotation.as_quaternion()
    turned = np.cumprod(np.where((found[1:] * found[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    return found * np.concatenate([[1.0], turned])[:, None]
