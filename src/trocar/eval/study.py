"""Studies: several runs of a task in the same sessions, reduced to rows (``trocar.eval.jobs`` runs them)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from trocar.counting import Tick, untold
from trocar.errors import InvalidInput, TrocarError, UnknownName
from trocar.eval.config import RunConfig
from trocar.eval.method import methods_of, pick_method
from trocar.eval.statistics import InSession, Value, by_session
from trocar.eval.task import Task
from trocar.eval.trial import Trial, trial_file
from trocar.files.output import MADE_BY, write_json
from trocar.files.reading import read_json
from trocar.registry import loaded


@dataclass(frozen=True, eq=False)
class Condition:
    """One condition of a study, an ordinary run.

    Attributes:
        name: what distinguishes it from the others besides its method, such as the task's variant.
        config: configuration of its run.
        folder: its run's folder, for ``trocar report`` and ``trocar view``.
    """

    name: str
    config: RunConfig
    folder: Path

    @property
    def method(self) -> str:
        """Return the name of its method."""
        return self.config.method

    @property
    def places(self) -> list[tuple[int, int]]:
        """Return (session, trial) of all its trials."""
        return [(s, k) for s in range(self.config.sessions) for k in range(self.config.trials)]


def chosen(text: str, choices: Sequence[str], flag: str) -> list[str]:
    """Return the words of a comma-separated list; all choices if it is empty.

    Raises:
        UnknownName: a word is not among the choices.
        InvalidInput: a word is given twice, or is missing between two commas.
    """
    words = [word.strip() for word in text.split(",")] if text else list(choices)
    for word in words:
        if not word:
            raise InvalidInput(f"--{flag} {text!r}", "has a comma too many", f"choose from {', '.join(choices)}")
        if word not in choices:
            raise UnknownName(f"--{flag}", word, choices)
        if words.count(word) > 1:
            raise InvalidInput(f"--{flag}", f"names {word!r} twice", "name each once")
    return words


class Row(InSession, Protocol):
    """What a study needs from a trial: a dataclass whose fields are JSON values."""

    @property
    def fingerprint(self) -> str:
        """Return the fingerprint of its run."""
        ...


AnyRow = TypeVar("AnyRow", bound=Row)


@dataclass(frozen=True)
class RowKind(Generic[AnyRow]):
    """How a trial is reduced to a row, which is saved beside it.

    Attributes:
        row: class of the row.
        made: function that makes the row of a trial.
        version: version of the row's fields and of ``made``; rows of another version are made again.
    """

    row: Callable[..., AnyRow]
    made: Callable[[Trial], AnyRow]
    version: int = 1

    def read(self, trial: str | Path, fingerprint: str) -> AnyRow:
        """Return the row of a trial's file, whose run has this fingerprint; make and save it if there is no valid one.

        Raises:
            BadFile: the trial cannot be read.
        """
        path = row_file(trial)
        try:
            values = read_json(path)
            values.pop(MADE_BY, None)
            if values.pop("version") == self.version and values["fingerprint"] == fingerprint:
                return self.row(**values)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            pass
        row = self.made(Trial.load(trial))
        values: dict[str, Any] = {"version": self.version, **asdict(row)}  # type: ignore[call-overload]
        path.unlink(missing_ok=True)  # nothing is lost, since the trial has the same information
        write_json(path, values, "row of a trial")
        return row


def row_file(trial: str | Path) -> Path:
    """Return the path of a trial's row."""
    return Path(trial).with_suffix(".row.json")


@dataclass(frozen=True, eq=False)
class Results(Generic[AnyRow]):
    """The rows of a condition's trials."""

    condition: Condition
    rows: Sequence[AnyRow]

    def by_session(self, value: Callable[[AnyRow], Value]) -> dict[int, list[Value]]:
        """Return one value per trial, by session."""
        return by_session(self.rows, value)


def read_study(
    conditions: Sequence[Condition], kind: RowKind[AnyRow], tick: Tick = untold
) -> tuple[list[Results[AnyRow]], list[str]]:
    """Return the results of all conditions that have a trial, and a sentence for each trial that is missing.

    At most one trial is in memory at a time.

    Raises:
        InvalidInput: there is no trial at all.
    """
    found: list[Results[AnyRow]] = []
    missing: list[str] = []
    total, done = sum(len(one.places) for one in conditions), 0
    for condition in conditions:
        rows = []
        for place in condition.places:
            try:
                rows.append(kind.read(trial_file(condition.folder, *place), condition.config.fingerprint))
            except TrocarError as error:
                missing.append(f"left aside: {error}")
            done += 1
            tick("reading trials", done, total)
        if rows:
            found.append(Results(condition, rows))
    if not found:
        raise InvalidInput("the study", "has no trial that can be read", "run it without --report-only")
    return found, missing


@dataclass(frozen=True)
class TableData:
    """A table, for the terminal and for a page.

    Attributes:
        title: title above the table.
        head: names of the columns.
        rows: cells of each row; the first is the row's name.
        caption: text below the table.
        page_only: columns that do not fit into a terminal.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    page_only: Sequence[str] = ()


class TaskStudy(Generic[AnyRow]):
    """A task's study: all methods at all values of one option, beside the paper's figures.

    Class attributes:
        varied: the task's option that is varied, besides the method.
        values: this option's values.
        kind: how a trial is reduced to a row.
        captions: the pictures' captions, by file name.
        notes: sentences that a reader of the figures must know.
    """

    varied: ClassVar[str]
    values: ClassVar[Sequence[Any]]
    kind: RowKind[AnyRow]
    captions: ClassVar[Mapping[str, str]] = {}
    notes: ClassVar[Sequence[str]] = ()

    def figures(self, results: Results[AnyRow]) -> dict[str, Any]:
        """Return the figures of one condition as JSON values."""
        raise NotImplementedError

    def summary(self, results: Sequence[Results[AnyRow]], cells: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return further keys of the study's summary; ``cells`` are the figures of the conditions."""
        raise NotImplementedError

    def about(self, summary: Mapping[str, Any]) -> str:
        """Return the line below the title of the page."""
        raise NotImplementedError

    def tables(self, summary: Mapping[str, Any]) -> list[TableData]:
        """Return the study's tables."""
        raise NotImplementedError

    def remarks(self, summary: Mapping[str, Any]) -> list[str]:
        """Return sentences that follow from the figures."""
        del summary
        return []

    def pictures(self, folder: Path, results: Sequence[Results[AnyRow]], summary: Mapping[str, Any]) -> list[Path]:
        """Draw the study's pictures and return their paths."""
        raise NotImplementedError


def study_of(task: type[Task]) -> TaskStudy[Any]:
    """Return the study of a task.

    Raises:
        InvalidInput: the task has none.
    """
    kind = loaded(task.study)
    if kind is None:
        raise InvalidInput(f"task {task.name!r}", "has no study", "give its class the attribute `study`")
    return kind()


def conditions_of(
    task: type[Task],
    folder: str | Path,
    *,
    values: str = "",
    methods: str = "",
    model: str = "",
    options: Mapping[str, Any] | None = None,
    **run: Any,
) -> list[Condition]:
    """Return the conditions of a task's study in the order of its tables.

    Args:
        task: class of a task that has a study.
        folder: folder of the study, with one for each condition in it.
        values: the varied option's values, comma-separated; empty: all.
        methods: names of the methods, likewise.
        model: cable model of the methods that compensate; empty: the default.
        options: the task's options, besides the varied one.
        run: the other options of ``RunConfig``.
    """
    study = study_of(task)
    picked = chosen(methods, list(methods_of(task)), "methods")
    compensate = {method: pick_method(task, method).calibrated for method in picked}
    if model and not any(compensate.values()):
        problem = f"has no effect with {', '.join(picked)} of {task.name}, which make no calibration"
        raise InvalidInput(f"--model {model}", problem, "drop --model")
    by_word = {str(value): value for value in study.values}
    found = []
    for word in chosen(values, list(by_word), f"{study.varied.removesuffix('s')}s"):
        for method in picked:
            done = task(**(options or {}), **{study.varied: by_word[word]})
            config = RunConfig(done, method=method, model=model if compensate[method] else "", **run)
            found.append(Condition(done.variant, config, (Path(folder) / f"{done.variant}-{method}").absolute()))
    return found
