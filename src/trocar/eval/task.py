"""The definition of a task: a scene, what counts as done, and the methods."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from trocar.calibration.excitation import MotionBox
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
    """Return the dataclass field of an option of a task or a run, which the command line offers as described here.

    Args:
        default: if the option is not given; its type is the option's, and the field's annotation.
        help: one line.
        flag: on the command line, if not the field's name with dashes.
        metavar: placeholder for the value in the help.
        choices: the values that it may have; none: any.
        shown: the default in words, where its value does not tell.
    """
    about = {"help": help, "flag": flag, "metavar": metavar, "choices": tuple(choices), "shown": shown}
    return field(default=default, metadata=about)


def flag_of(field: Field[Any]) -> str:
    """Return how a field of a task or a run is spelt on the command line: ``--new-session``."""
    return f"--{(field.metadata.get('flag') or field.name).replace('_', '-')}"


@dataclass(frozen=True)
class Score:
    """The outcome of one goal, as the referee saw it.

    Attributes:
        attempted: counts in the denominator: whatever the task set out to do.
        succeeded: it was done.
        failure: name of what went wrong, empty after a success.
        reason: a sentence, if there is one.
        start_s: on the trial's clock.
        end_s: likewise.
    """

    attempted: bool
    succeeded: bool
    failure: str
    reason: str
    start_s: float
    end_s: float

    def __repr__(self) -> str:
        result = "done" if self.succeeded else self.failure or ("failed" if self.attempted else "not attempted")
        why = f": {self.reason}" if self.reason else ""
        return f"<Score {result}, {self.start_s:.1f} to {self.end_s:.1f} s{why}>"


class Task:
    """What is to be done, independent of how it is done. A task is a frozen dataclass whose fields are its options.

    Class attributes:
        name: on the command line.
        about: one line.
        goal_noun: what one goal is called: ``transfer``, ``suture``. Scripts note the end of each as an event of that
            name.
        station: name of the station where it is done if none is given.
        methods: how it can be done, by name, the default first.
        perceptions: by name; whatever its agents expect of them.
        objects: what policies see of its objects, a class of ``Objects``; None: nothing.
        report: its own pictures, tables and figures.
        study: for ``trocar study``; None: it has none.
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
    """A trial that takes longer on the cell's clock is stopped."""
    variant: str = ""
    """Which variant of the task this is, if there are several."""

    @property
    def usual_station(self) -> str:
        """Return the name of the station where this variant is done if none is given."""
        return type(self).station

    def options(self) -> dict[str, Any]:
        """Return the options as JSON values: what distinguishes one run of this task from another."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    def done_at(self, station: Station) -> Self:
        """Return the task as it is done at a station, where that determines what is to be done; by default the same.

        Raises:
            InvalidInput: it cannot be done there.
        """
        del station
        return self

    def at(self, station: Station) -> Station:
        """Return the station as this task needs it.

        Raises:
            InvalidInput: it cannot be done there.
        """
        return station

    def working_arms(self, station: Station) -> tuple[str, ...]:
        """Return the names of the arms that work; the others stay parked. By default the first."""
        return (next(iter(station.arms)),)

    def goals(self) -> Sequence[Any]:
        """Return what is to be done, in order: the same for every agent, and the score's denominator."""
        raise self._lacks("goals()")

    def nominal(self) -> Any:
        """Return what is known about the scene beforehand, such as shapes; agents are given it."""
        return None

    def scene(self, rng: np.random.Generator, station: Station) -> Any:
        """Return what truly lies on the table in one trial."""
        raise self._lacks("scene(rng, station)")

    def world(self, scene: Any) -> TaskWorld:
        """Return the simulator's side of a scene: bodies and referee."""
        raise self._lacks("world(scene)")

    def score(self, truth: Any, events: Sequence[Mapping[str, Any]]) -> Sequence[Score]:
        """Return one score for each goal, in order, from what really happened.

        Args:
            truth: what the task's world made of the record.
            events: what the script noted. They may explain a failure; they decide nothing.
        """
        raise self._lacks("score(truth, events)")

    def told(self, events: Sequence[Mapping[str, Any]]) -> Sequence[Score]:
        """Return one score for each goal, in order, as the script itself noted them: where no referee sees the truth.

        Raises:
            InvalidInput: this task needs a referee.
        """
        del events
        problem = "has no way to count goals without a referee, which a robot has not"
        raise InvalidInput(f"task {self.name!r}", problem, "give its class a method told(events)")

    def calibration(self, station: Station, arm: str) -> MotionBox:
        """Return where the motion of a calibration recording should go: as the station says, by default."""
        return station.calibration_box(arm)

    def _lacks(self, method: str) -> InvalidInput:
        name = method.partition("(")[0]
        return InvalidInput(f"task {self.name!r}", f"has no {name}", f"give its class a method {method}")


def agent_explanation(noted: Mapping[str, Any] | None, events: Sequence[Mapping[str, Any]]) -> tuple[str, str] | None:
    """Return what a script itself noted about a goal that was not reached, outcome and reason; None if nothing.

    Args:
        noted: the event with which it noted the goal's end, if it did. That it said ``DONE`` explains nothing.
        events: all that it noted.
    """
    if noted is None:
        given_up = stopped(events)
        return given_up if given_up[0] else None
    outcome = str(noted.get("outcome", ""))
    return None if outcome in ("", "DONE") else (outcome, str(noted.get("reason", "")))


def check_budget(budget_s: float) -> None:
    """Raise unless a trial's budget is a time."""
    if not 0 < budget_s < math.inf:
        raise InvalidValue("the budget of a trial", f"{budget_s} s", "give a finite time above 0 with --budget")


def require_task(name: str, task: Any) -> None:
    """Raise unless a class has what a run needs from a task before it begins.

    Raises:
        InvalidInput: it is not a dataclass derived from ``Task``, or lacks an attribute or a method of its own.
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


def stopped(events: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Return outcome and reason with which a whole script was abandoned; empty if it was not."""
    last = next((e for e in reversed(events) if e["name"] == "stopped"), None)
    return (str(last["outcome"]), str(last.get("reason", ""))) if last else ("", "")


TASKS: Registry[type[Task]] = Registry("task", "trocar.tasks", check=require_task)
"""Every task by its name on the command line."""
