"""The definition of a task: its goals, its scene, its score and its methods."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from trocar.calibration.excitation import MotionBox
from trocar.checks import takes
from trocar.errors import InvalidInput, InvalidValue
from trocar.lab import Station
from trocar.registry import Lazy, Registry

if TYPE_CHECKING:
    from trocar.eval.method import Method
    from trocar.eval.objects import Objects
    from trocar.eval.study import TaskStudy
    from trocar.eval.task_report import TaskReport
    from trocar.sim.world import TaskWorld


def option(
    default: Any = MISSING,
    help: str = "",
    *,
    flag: str = "",
    metavar: str = "",
    choices: Sequence[str] = (),
    shown: str = "",
) -> Any:
    """Return a dataclass field that is an option of a task or a run, also on the command line.

    Args:
        default: default value, of the type of the field's annotation.
        help: help in one line.
        flag: name on the command line, if not the field's name with dashes.
        metavar: placeholder for the value in the help.
        choices: allowed values; empty: any.
        shown: the default in words, for the help, where its value is not clear.
    """
    about = {"help": help, "flag": flag, "metavar": metavar, "choices": tuple(choices), "shown": shown}
    return field(default=default, metadata=about)


def flag_of(field: Field[Any]) -> str:
    """Return the command-line flag of an option of a task or a run: ``--new-session``."""
    return f"--{(field.metadata.get('flag') or field.name).replace('_', '-')}"


_SCORED: tuple[tuple[tuple[str, ...], Any, str], ...] = (
    (("attempted", "succeeded"), bool, "give True or False"),
    (("failure", "reason"), str, "give a text, which may be empty"),
    (("start_s", "end_s"), (int, float), "give a finite number of seconds"),
)
"""Fields of a score with their kinds, and what to give instead of another."""


@dataclass(frozen=True)
class Score:
    """The outcome of one goal, as the referee saw it.

    Attributes:
        attempted: whether the goal counts in the denominator.
        succeeded: whether the goal was reached.
        failure: name of what went wrong; empty after a success.
        reason: explanation in a sentence, or empty.
        start_s: start on the trial's clock.
        end_s: end on the trial's clock.

    NumPy's numbers become Python's, also in the fields of derived classes.

    Raises:
        InvalidInput: a field is of another kind, or a time is not finite.
    """

    attempted: bool
    succeeded: bool
    failure: str
    reason: str
    start_s: float
    end_s: float

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.generic | np.ndarray):
                object.__setattr__(self, one.name, value.tolist())
        for names, kinds, remedy in _SCORED:
            for name in names:
                value = getattr(self, name)
                sensible = isinstance(value, kinds) and isinstance(value, bool) == (kinds is bool)
                if not sensible or (isinstance(value, float) and not math.isfinite(value)):
                    raise InvalidInput(f"{name} of a {type(self).__name__}", f"is {value!r}", remedy)

    def __repr__(self) -> str:
        result = "done" if self.succeeded else self.failure or ("failed" if self.attempted else "not attempted")
        why = f": {self.reason}" if self.reason else ""
        return f"<Score {result}, {self.start_s:.1f} to {self.end_s:.1f} s{why}>"


class Task:
    """What is to be done, independent of how it is done. A task is a frozen dataclass whose fields are its options.

    Class attributes:
        name: name on the command line.
        about: description in one line.
        goal_noun: what one goal is called, such as ``transfer`` or ``suture``; scripts note the end of each goal as an
            event of this name.
        station: name of its default station.
        methods: its methods by name, the default first.
        perceptions: its perceptions by name, with whatever interface its agents expect.
        objects: class of ``Objects`` from which policies see its objects; None: they see nothing of them.
        report: its own pictures, tables and figures.
        study: its study, for ``trocar study``; None: it has none.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    goal_noun: ClassVar[str] = "goal"
    station: ClassVar[str]
    methods: ClassVar[Mapping[str, Method | Lazy]]
    perceptions: ClassVar[Mapping[str, Any]] = {}
    objects: ClassVar[Callable[..., Objects] | Lazy | None] = None
    report: ClassVar[TaskReport | Lazy | None] = None
    study: ClassVar[type[TaskStudy[Any]] | Lazy | None] = None

    budget_s: float
    """Longest duration of a trial on the cell's clock; then it is stopped."""
    variant: str = ""
    """Name of this variant of the task, if there are several."""

    @property
    def usual_station(self) -> str:
        """Return the name of this variant's default station."""
        return type(self).station

    def options(self) -> dict[str, Any]:
        """Return the options as JSON values; they distinguish one run of this task from another."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    def done_at(self, station: Station) -> Self:
        """Return the task adapted to a station, for tasks whose goals depend on it; by default unchanged.

        Raises:
            InvalidInput: the task cannot be done there.
        """
        del station
        return self

    def at(self, station: Station) -> Station:
        """Return the station as this task needs it; by default unchanged.

        Raises:
            InvalidInput: the task cannot be done there.
        """
        return station

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the names of the arms that work; the others stay parked. By default the first."""
        return (next(iter(station.arms)),)

    def goals(self) -> Sequence[Any]:
        """Return the goals, in order; they are the same for every agent, and the score's denominator."""
        raise self._lacks("goals()")

    def nominal(self) -> Any:
        """Return what agents know about the scene beforehand, such as shapes."""
        return None

    def scene(self, rng: np.random.Generator, station: Station) -> Any:
        """Return what truly lies on the table in one trial."""
        raise self._lacks("scene(rng, station)")

    def world(self, scene: Any) -> TaskWorld:
        """Return the simulator's side of a scene: bodies and referee."""
        raise self._lacks("world(scene)")

    def score(self, truth: Any, events: Sequence[Mapping[str, Any]]) -> Sequence[Score]:
        """Return one score for each goal, in order, from the truth.

        Args:
            truth: the task's truth, which its world makes from the record.
            events: events that the script noted; they may explain a failure, but decide nothing.
        """
        raise self._lacks("score(truth, events)")

    def told(self, events: Sequence[Mapping[str, Any]]) -> Sequence[Score]:
        """Return one score for each goal, in order, as the script noted them; for robots, which have no referee.

        Raises:
            InvalidInput: this task needs a referee.
        """
        del events
        problem = "has no way to count goals without a referee, which a robot has not"
        raise InvalidInput(f"task {self.name!r}", problem, "give its class a method told(events)")

    def calibration(self, station: Station, arm: str) -> MotionBox:
        """Return the range of the motion of a calibration recording; by default the station's."""
        return station.calibration_box(arm)

    def _lacks(self, method: str) -> InvalidInput:
        name = method.partition("(")[0]
        return InvalidInput(f"task {self.name!r}", f"has no {name}", f"give its class a method {method}")


def agent_explanation(noted: Mapping[str, Any] | None, events: Sequence[Mapping[str, Any]]) -> tuple[str, str] | None:
    """Return outcome and reason that a script noted for a goal that it did not reach; None if it noted nothing.

    Args:
        noted: the event with which the script noted the goal's end, if any; an outcome ``DONE`` explains nothing.
        events: all events of the script.
    """
    if noted is None:
        given_up = stopped(events)
        return given_up if given_up[0] else None
    outcome = str(noted.get("outcome", ""))
    return None if outcome in ("", "DONE") else (outcome, str(noted.get("reason", "")))


def check_budget(budget_s: float) -> None:
    """Raise InvalidValue unless a trial's budget is finite and above 0."""
    if not 0 < budget_s < math.inf:
        raise InvalidValue("the budget of a trial", f"{budget_s} s", "give a finite time above 0 with --budget")


def require_task(name: str, task: Any) -> None:
    """Check that a class has what a run needs from a task.

    Raises:
        InvalidInput: it is not a dataclass derived from ``Task``, lacks an attribute or a method of its own, or has a
            method that takes other parameters than that of ``Task``.
    """
    if not (isinstance(task, type) and issubclass(task, Task) and is_dataclass(task)):
        raise InvalidInput(
            f"task {name!r}", f"is {task!r}", "register a frozen dataclass derived from trocar.eval.Task"
        )
    missing = [name for name in ("name", "about", "station", "methods") if not getattr(task, name, None)]
    missing += [] if "budget_s" in {f.name for f in fields(task)} else ["budget_s"]
    if missing:
        raise InvalidInput(f"task {task.__name__}", f"has no {', '.join(missing)}", "give its class these attributes")
    inherited = [name for name in ("goals", "scene", "world", "score") if getattr(task, name) is getattr(Task, name)]
    if inherited:
        methods = ", ".join(f"{name}()" for name in inherited)
        raise InvalidInput(f"task {task.__name__}", f"has no {methods}", "give its class these methods")
    blank = object.__new__(task)  # binds methods, static ones too, without options
    for method, usual in vars(Task).items():
        if method.startswith("_") or not inspect.isfunction(usual):
            continue
        wanted, own = [*inspect.signature(usual).parameters][1:], getattr(blank, method, None)
        if not (callable(own) and takes(own, len(wanted))):
            called = f"cannot be called as {method}({', '.join(wanted)})"
            raise InvalidInput(f"{method} of task {task.__name__}", called, "give it these parameters")


def stopped(events: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Return outcome and reason with which a whole script was stopped; empty if it was not."""
    last = next((e for e in reversed(events) if e["name"] == "stopped"), None)
    return (str(last["outcome"]), str(last.get("reason", ""))) if last else ("", "")


TASKS: Registry[type[Task]] = Registry("task", "trocar.tasks", check=require_task)
"""Every task by its name on the command line."""
