"""Sweeps: one task, several methods, flaws of several sizes and seeds, in one table and one picture."""

from __future__ import annotations

import inspect
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

from matplotlib.axes import Axes
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval import TASKS, Task, methods_of
from trocar.eval.comparison import ratio_estimate, session_estimate
from trocar.eval.config import MAX_TRIALS, RunConfig
from trocar.eval.method import pick_method
from trocar.eval.statistics import by_session, session_interval
from trocar.eval.study import Condition, RowKind, TableData
from trocar.eval.trial import Trial
from trocar.files.output import write_json
from trocar.lab.flaws import FLAWS, MILD, MOST_SCALE, SHOWN, Difficulty
from trocar.report import style
from trocar.report.tables import rated

WIDTH_IN, HEIGHT_IN = 2.7, 4.4
OWN_KEYS = ("task", "methods", "seeds", "flaws", "options")
"""Keys of a sweep's file besides the options of a run."""
RUN_KEYS = tuple(
    f.name for f in fields(RunConfig) if f.init and f.name not in ("task", "method", "seed", "flaws", "plugins")
)
COMPENSATED_ALONE = ("model", "calibration", "prior", "new_session", "refit_offsets")
"""Options of methods with a calibration; a sweep does not give them to others."""
NOTES = (
    "intervals of 95 %, over sessions: success beta-binomial, collisions Student's t; all conditions had the same "
    "sessions and scenes",
    "goals reached are counted out of all goals: a block lost in an earlier transfer counts as one that was not moved",
    "a dotted line is the size that recordings show, or that is assumed (docs/simulator.md)",
)


@dataclass(frozen=True, eq=False)
class Point:
    """One point of a sweep's curves: a method at one size of one flaw, with a run for each seed.

    Attributes:
        method: name of the method.
        flaw: name of the flaw; empty in a sweep of methods only.
        scale: the flaw's size, as a multiple of the recorded one.
        conditions: its runs; identical ones are shared by several points.
    """

    method: str
    flaw: str
    scale: float
    conditions: tuple[Condition, ...]

    @property
    def size(self) -> float:
        """Return the flaw's size in :attr:`unit`."""
        if not self.flaw:
            return 0.0
        flaw = FLAWS[self.flaw]
        return SHOWN[flaw.unit][1] * flaw.size(self.conditions[0].config.laboratory.difficulty[self.flaw])

    @property
    def unit(self) -> str:
        """Return the unit of the size: 'mm', 'deg', or 'x' for multiples of the recorded size."""
        return (SHOWN[FLAWS[self.flaw].unit][0] or "x") if self.flaw else ""


@dataclass(frozen=True)
class Sweep:
    """The content of a sweep's file; see ``examples/sweep.toml``.

    Attributes:
        task: with its options.
        methods: names; by default all that the task has.
        seeds: each draws sessions of its own.
        flaws: sizes of each flaw that is varied, as multiples of what was recorded.
        run: other options of its runs, as in ``RunConfig``.
    """

    task: Task
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    flaws: Mapping[str, Sequence[float]]
    run: Mapping[str, Any]

    @staticmethod
    def read(path: str | Path) -> Sweep:
        """Return the sweep in a TOML file.

        Raises:
            BadFile: it cannot be read, or names no task.
            UnknownName: a key, the task, a method or a flaw is unknown.
            InvalidInput: a value is not of its kind.
        """
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            problem = f"is no readable TOML file ({error})"
            raise BadFile(path, problem, "see examples/sweep.toml", kind="sweep") from None
        for key in values:
            if key not in (*OWN_KEYS, *RUN_KEYS):
                raise UnknownName(f"key of {str(path)!r}", key, (*OWN_KEYS, *RUN_KEYS))
        if not isinstance(values.get("task"), str):
            raise BadFile(path, "names no task", 'give one, as task = "peg-transfer"', kind="sweep")
        for key in ("options", "flaws"):
            if not isinstance(values.get(key, {}), dict):
                raise InvalidInput(f"{key} of {str(path)!r}", f"is {values[key]!r}", f"write a table, [{key}]")
        task, options = TASKS.pick(values["task"]), values.get("options", {})
        names = [f.name for f in fields(task)]  # type: ignore[arg-type]
        for name in options:
            if name not in names:
                raise UnknownName(f"option of {task.name}", name, names)
        run = {key: value for key, value in values.items() if key in RUN_KEYS}
        _require_kinds(path, task, options)
        _require_kinds(path, RunConfig, run)
        methods = _listed(path, "methods", values.get("methods") or list(methods_of(task)), str)
        for method in methods:
            pick_method(task, method)
        return Sweep(
            task(**options),
            methods,
            _listed(path, "seeds", values.get("seeds", [0]), int),
            {flaw: _sizes(flaw, sizes) for flaw, sizes in values.get("flaws", {}).items()},
            run,
        )

    def points(self, folder: str | Path, plugins: Sequence[str] = ()) -> list[Point]:
        """Return the points of the curves; each run has a folder in the sweep's folder."""
        difficulty = self.run.get("difficulty", "recorded")
        conditions: dict[Path, Condition] = {}
        points = []
        for method in self.methods:
            calibrated = pick_method(type(self.task), method).calibrated
            given = {k: v for k, v in self.run.items() if calibrated or k not in COMPENSATED_ALONE}
            for flaw, scale in [(name, size) for name, sizes in self.flaws.items() for size in sizes] or [("", 1.0)]:
                named = _named(flaw, scale, difficulty)
                found = []
                for seed in self.seeds:
                    config = RunConfig(
                        self.task, method=method, seed=seed, flaws=named, plugins=tuple(plugins), **given
                    )
                    words = [method, difficulty, *(f"{flaw}-{scale:g}" for _ in named), f"seed-{seed}"]
                    home = (Path(folder) / "-".join(words)).absolute()
                    found.append(conditions.setdefault(home, Condition(self.task.variant, config, home)))
                relevant = found[0].config.laboratory.relevant_flaws(self.task.name)
                if flaw and flaw not in relevant:
                    raise UnknownName("flaw of this station", flaw, relevant)
                points.append(Point(method, flaw, scale, tuple(found)))
        return points


def _required(path: str | Path, key: str, kind: Any, value: Any) -> Any:
    """Return a value of a sweep's file, which TOML reads as JSON would, if it is of this kind (a type hint)."""
    strict = TypeAdapter(kind, config=ConfigDict(strict=True, arbitrary_types_allowed=True))
    try:
        return strict.validate_json(json.dumps(value, default=str))
    except ValidationError as error:
        wanted = error.errors()[0]["msg"].replace("Input should", "it should")
        raise InvalidInput(f"{key} of {str(path)!r}", f"is {value!r}", wanted) from None


def _listed(path: str | Path, key: str, given: Any, kind: type) -> tuple[Any, ...]:
    """Return a list of a sweep's file: different values of one kind, at least one."""
    values = _required(path, key, Annotated[tuple[kind, ...], Field(min_length=1)], given)
    if len(set(values)) < len(values):
        raise InvalidInput(f"{key} of {str(path)!r}", f"is {given!r}", "give each of them once")
    return values


def _require_kinds(path: str | Path, kind: type, given: Mapping[str, Any]) -> None:
    """Raise InvalidInput unless values of a sweep's file are of the kinds of a dataclass's fields."""
    classes = [one for one in reversed(kind.__mro__) if one not in (Task, object)]
    hints = {k: v for one in classes for k, v in inspect.get_annotations(one, eval_str=True).items()}
    for name, value in given.items():
        _required(path, name, hints[name], value)


def _named(flaw: str, scale: float, difficulty: str) -> tuple[str, ...]:
    """Return a flaw of this size as ``--flaw`` takes it; empty if the difficulty includes that size already."""
    if not flaw or (difficulty != MILD and Difficulty.of(difficulty).scale(flaw) == scale):
        return ()
    kind = FLAWS[flaw]
    return (f"{flaw}={scale * kind.size(kind.values('recorded')):.6g}{kind.unit}",)


def _sizes(flaw: str, sizes: Any) -> list[float]:
    if flaw not in FLAWS:
        raise UnknownName("flaw", flaw, FLAWS)
    good = isinstance(sizes, list) and all(
        isinstance(size, int | float) and not isinstance(size, bool) and 0.0 <= size <= MOST_SCALE for size in sizes
    )
    if not good or len(set(sizes)) < max(len(sizes), 1):
        remedy = f"give different numbers from 0 to {MOST_SCALE:g}, times what was recorded, as in [0, 1, 2]"
        raise InvalidInput(f"flaw {flaw!r}", f"has the sizes {sizes}", remedy)
    return sorted(map(float, sizes))


def conditions_of(points: Sequence[Point]) -> list[Condition]:
    """Return the runs of these points, each once."""
    return list({one.folder: one for point in points for one in point.conditions}.values())


@dataclass(frozen=True)
class Row:
    """One trial of any task: its run and place, its goals and how many were reached, collisions, length."""

    fingerprint: str
    session: int
    index: int
    goals: int
    succeeded: int
    collisions: int
    duration_s: float


def _row_of(trial: Trial) -> Row:
    return Row(
        fingerprint=str(trial.about["fingerprint"]),
        session=int(trial.about["session"]),
        index=int(trial.about["index"]),
        goals=len(trial.scores),
        succeeded=sum(bool(score["succeeded"]) for score in trial.scores),
        collisions=len(trial.collisions),
        duration_s=trial.duration_s,
    )


KIND = RowKind(Row, _row_of)


def figures_of(point: Point, rows_of: Mapping[Any, Sequence[Row]]) -> dict[str, Any] | None:
    """Return the figures of a point with their 95 % intervals over sessions, as JSON values; None without a trial."""
    rows = [
        replace(row, session=number * MAX_TRIALS + row.session)  # sessions of different seeds differ
        for number, condition in enumerate(point.conditions)
        for row in rows_of.get(condition.folder, ())
    ]
    if not rows:
        return None
    reached = [sum(values) for values in by_session(rows, lambda row: row.succeeded).values()]
    goals = [sum(values) for values in by_session(rows, lambda row: row.goals).values()]
    collisions = session_estimate(by_session(rows, lambda row: float(row.collisions)))
    seconds = ratio_estimate(by_session(rows, lambda row: (row.duration_s, float(row.succeeded))))
    return {
        "name": point.conditions[0].folder.name.rpartition("-seed-")[0],
        "method": point.method,
        "flaw": point.flaw,
        "scale": point.scale,
        "size": point.size,
        "unit": point.unit,
        "folders": [condition.folder.name for condition in point.conditions],
        "sessions": len(reached),
        "trials": len(rows),
        "goals": sum(goals),
        "succeeded": sum(reached),
        "success": sum(reached) / sum(goals),
        "success_ci95": list(session_interval(reached, goals)),
        "collisions_per_trial": asdict(collisions.not_negative()),
        "s_per_success": asdict(seconds.not_negative()) if seconds else None,
    }


def write_sweep(
    folder: str | Path, task: str, figures: Sequence[Mapping[str, Any]], missing: Sequence[str]
) -> tuple[dict[str, Any], list[Path]]:
    """Write ``summary.json`` and ``sweep.png``; return the summary and the files."""
    folder = Path(folder)
    summary = {"study": "sweep", "task": task, "conditions": list(figures), "notes": [*NOTES, *missing]}
    path = write_json(folder / "summary.json", summary, "summary of a study")
    return summary, [path, draw_curves(figures, folder / "sweep.png")]


def tables_of(figures: Sequence[Mapping[str, Any]]) -> list[TableData]:
    """Return a table for each flaw."""
    tables = []
    head = ("method", "size", "goals reached", "%", "collisions per trial", "s for each")
    for flaw in dict.fromkeys(row["flaw"] for row in figures):
        lines = []
        for row in (row for row in figures if row["flaw"] == flaw):
            size = f"{row['size']:.3g} {row['unit']}" + (" (recorded)" if row["scale"] == 1.0 else "") if flaw else "-"
            rate = rated(row["success"], row["success_ci95"])
            seconds = f"{row['s_per_success']['mean']:.1f}" if row["s_per_success"] else "-"
            hits = f"{row['collisions_per_trial']['mean']:.2f}"
            lines.append((row["method"], size, f"{row['succeeded']} of {row['goals']}", rate, hits, seconds))
        tables.append(TableData(f"{flaw}: {FLAWS[flaw].about}" if flaw else "Methods", head, lines))
    return tables


def draw_curves(summaries: Sequence[Mapping[str, Any]], path: str | Path) -> Path:
    """Draw a column for each flaw, success above collisions, a curve for each method; return the path."""
    path = Path(path)
    flaws, methods = (list(dict.fromkeys(row[key] for row in summaries)) for key in ("flaw", "method"))
    with style.figure(1.0 + WIDTH_IN * len(flaws), HEIGHT_IN, path) as figure:
        grid = figure.subplots(2, len(flaws), squeeze=False, sharex="col", sharey="row")
        for (top, bottom), flaw in zip(grid.T, flaws, strict=True):
            of_flaw = [row for row in summaries if row["flaw"] == flaw]
            for method, colour in zip(methods, style.SERIES * len(methods), strict=False):
                rows = [row for row in of_flaw if row["method"] == method]
                x = [row["size"] for row in rows] if flaw else [float(methods.index(method))]
                ends = [[100 * end for end in row["success_ci95"]] for row in rows]
                _curve(top, x, [100 * row["success"] for row in rows], ends, colour)
                hits = [row["collisions_per_trial"] for row in rows]
                known = all(hit["low"] is not None for hit in hits)
                ends = [[hit["low"], hit["high"]] for hit in hits] if known else []
                _curve(bottom, x, [hit["mean"] for hit in hits], ends, colour)
            varied = next((row for row in of_flaw if row["scale"] > 0 and flaw), None)
            for axes in (top, bottom):
                if varied is not None:
                    recorded = varied["size"] / varied["scale"]
                    axes.axvline(recorded, color=style.QUIET, linewidth=0.8, linestyle=":")
            top.set_title(flaw)
            unit = of_flaw[0]["unit"]
            bottom.set_xlabel("times what was recorded" if unit == "x" else unit)
        if flaws == [""]:
            grid[1, 0].set_xticks(range(len(methods)), methods, rotation=30)
        grid[0, 0].set_ylim(0.0, 102.0)
        grid[1, 0].set_ylim(bottom=0.0)
        grid[0, 0].set_ylabel("goals reached, %")
        grid[1, 0].set_ylabel("collisions per trial")
        lines = dict(zip(methods, grid[0, 0].lines, strict=False))
        title = "bars: 95 % interval over sessions"
        figure.legend(
            lines.values(), lines, loc="outside lower center", ncols=len(methods), title=title, title_fontsize=8
        )
    return path


def _curve(axes: Axes, x: list[float], values: list[float], ends: list[list[float]], colour: str) -> None:
    """Draw values with their intervals, if these are known."""
    axes.plot(x, values, "o-", color=colour, markersize=3.5)
    if ends:
        low, high = zip(*ends, strict=True)
        axes.vlines(x, low, high, color=colour, alpha=0.4, linewidth=1.2)
