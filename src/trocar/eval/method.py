"""Methods, which say how a task is done: an agent, its settings, and what it is given."""

from __future__ import annotations

import json
import math
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Any, Protocol

import numpy as np

from trocar.cell import Cell, Robot
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.eval.objects import Objects
from trocar.eval.task import TASKS, Task
from trocar.motion.plan import Planner
from trocar.registry import Lazy, Registry, loaded

CLIENT = "client"
"""Method of trials that an outside program played."""


class Agent(Protocol):
    """A script that tries to reach a task's goals."""

    async def run(self) -> None:
        """Do the task; return when there is nothing left to do."""
        ...


def begun(agent: Agent) -> Awaitable[None]:
    """Return what is to be awaited for an agent to do its task.

    Raises:
        InvalidInput: it has no coroutine function ``run``.
    """
    run = getattr(agent, "run", None)
    script = run() if callable(run) else None
    if not isinstance(script, Awaitable):
        remedy = "give its class a method `async def run(self)`"
        raise InvalidInput(f"agent {type(agent).__name__}", "has no coroutine function run", remedy)
    return script


@dataclass(frozen=True, eq=False)
class AgentContext:
    """What an agent is given.

    Attributes:
        cell: devices, and what registration found.
        goals: what is to be done, in order.
        nominal: what is known about the scene beforehand, such as shapes; defined by the task.
        arms: names of the arms that work.
        planner: plans the agent's motions.
        perception: turns images into poses; None if the task has none.
        rng: the agent's own random generator.
        settings: the method's settings.
        objects: makes the ``Objects`` from which a policy sees the task's objects; None if the task has none.
    """

    cell: Cell
    goals: Sequence[Any]
    nominal: Any
    arms: tuple[str, ...]
    planner: Planner
    perception: Any
    rng: np.random.Generator
    settings: Any
    objects: Callable[[], Objects] | None = None


@dataclass(frozen=True)
class NoSettings:
    """Settings of a method that has none."""


@dataclass(frozen=True)
class Method:
    """One way to do a task.

    Attributes:
        about: description in one line.
        agent: class of its agent, or a function of an :class:`AgentContext` that returns one; ``Lazy`` if its import is
            expensive.
        settings: class of its settings, a dataclass whose fields have defaults, or a ``Lazy`` one.
        calibrated: whether the arms' cables are compensated by models fitted before the trials of a session.
        attended: whether a person at a console does the task.
        learns: whether the arms' cables are compensated by models that start from a prior alone, which the robot
            (``trocar.robots.Adaptive``) improves as it learns; excludes ``calibrated``.
        wrap_robot: function of the cell and the method's settings that returns the robot in an extra wrapper; None: no
            wrapper. A guard uses the wrapper's estimates if it is a ``JointEstimator``.
        stop_at_limits: whether to refuse a motion whose compensation would leave a joint's range; else the compensation
            is cut off at the range.
        planner: default planner, a name in ``PLANNERS``.
        perception: default perception, a name among the task's; empty if it has none.
    """

    about: str
    agent: Callable[[AgentContext], Agent] | Lazy
    settings: Callable[[], Any] | Lazy = NoSettings
    calibrated: bool = False
    learns: bool = False
    attended: bool = False
    wrap_robot: Callable[[Cell, Any], Robot] | Lazy | None = None
    stop_at_limits: bool = False
    planner: str = "spline"
    perception: str = ""

    def __post_init__(self) -> None:
        for name in ("agent", "settings"):
            value = getattr(self, name)
            if not (callable(value) or isinstance(value, Lazy)):
                raise InvalidValue(f"the {name} of method {self.about!r}", repr(value), "give a class or a Lazy")
        if self.calibrated and self.learns:
            raise InvalidInput(f"method {self.about!r}", "is both calibrated and learns", "choose one of them")

    def make_agent(self, context: AgentContext) -> Agent:
        """Return a new agent with this context."""
        return loaded(self.agent)(context)

    def wrapped(self, cell: Cell, settings: Any) -> Robot:
        """Return the cell's robot with this method's wrapper."""
        return cell.robot if self.wrap_robot is None else loaded(self.wrap_robot)(cell, settings)

    def make_settings(self, changes: Sequence[str] = ()) -> Any:
        """Return the settings.

        Args:
            changes: ``NAME=VALUE`` for each setting that differs from its default; nested names have dots.

        Raises:
            UnknownName: there is no such setting.
            InvalidInput: a setting cannot have this value.
        """
        settings = loaded(self.settings)()
        for change in changes:
            name, equals, text = change.partition("=")
            if not equals:
                raise InvalidInput(f"--set {change!r}", "has no value", "give NAME=VALUE, as in --set settle_s=.1")
            settings = _changed(settings, name.strip(), name.strip().split("."), text.strip())
        return settings


def listed_settings(settings: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of each setting; nested names have dots."""
    for one in fields(settings) if _has_fields(settings) else ():
        value = getattr(settings, one.name)
        if _has_fields(value):
            yield from listed_settings(value, f"{prefix}{one.name}.")
        else:
            yield prefix + one.name, value


def _has_fields(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type)


def _changed(settings: Any, name: str, path: Sequence[str], text: str) -> Any:
    names = [field.name for field in fields(settings)] if _has_fields(settings) else []
    if path[0] not in names:
        raise UnknownName("setting", name, [known for known, _ in listed_settings(settings)])
    value = getattr(settings, path[0])
    new = _changed(value, name, path[1:], text) if path[1:] else _parsed(f"setting {name!r}", text, value)
    return replace(settings, **{path[0]: new})


def _parsed(item: str, text: str, usual: Any) -> Any:
    """Return a text as a value of its default's type; ``item`` is its name in error messages."""
    if isinstance(usual, bool):
        if text not in ("true", "false"):
            raise InvalidValue(item, repr(text), "give true or false")
        return text == "true"
    if isinstance(usual, str):
        return text
    kind = type(usual)
    if kind not in (int, float, tuple, np.ndarray):
        raise InvalidInput(item, f"is {kind.__name__}", "it cannot be set from the command line")
    try:
        if kind in (int, float):
            number = kind(text)
            if math.isfinite(number):
                return number
        else:
            numbers = np.array(json.loads(f"[{text}]"), dtype=np.float64)
            if numbers.shape == np.shape(usual) and np.isfinite(numbers).all():
                return numbers if kind is np.ndarray else tuple(numbers.tolist())
    except (ValueError, TypeError):
        pass
    what = {int: "a whole number", float: "a number"}.get(kind, f"{np.size(usual)} numbers with commas")
    raise InvalidValue(item, repr(text), f"give {what}")


def make_task(kind: type[Task], changes: Sequence[str] = ()) -> Task:
    """Return a task with some of its options changed.

    Args:
        kind: class of the task.
        changes: ``NAME=VALUE`` for each option that differs from its default.

    Raises:
        UnknownName: there is no such option.
        InvalidInput: an option cannot have this value.
    """
    usual = {one.name: one.default for one in fields(kind)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, text = (part.strip() for part in change.partition("="))
        if not equals:
            raise InvalidInput(f"option {change!r}", "has no value", "give NAME=VALUE, as in variant=handover")
        if name not in usual:
            raise UnknownName(f"{kind.name} option", name, list(usual))
        default = "" if usual[name] is MISSING else usual[name]
        values[name] = _parsed(f"option {name!r}", text, default)
    return kind(**values)


def _require_method(name: str, method: Any) -> None:
    if not isinstance(method, Method):
        raise InvalidInput(f"method {name!r}", f"is {method!r}", "register a trocar.eval.Method")


def _require_place(what: str, name: str) -> None:
    if not all(name.partition("/")):
        raise InvalidInput(f"{what} {name!r}", "names no task", f"register it as TASK/{name.strip('/') or 'NAME'}")


def _require_method_from_outside(name: str, method: Any) -> None:
    _require_place("method", name)
    _require_method(name, method)


def _require_perception(name: str, perception: Any) -> None:
    _require_place("perception", name)
    if not callable(perception):
        raise InvalidInput(f"perception {name!r}", f"is {perception!r}", "register a class")


METHODS: Registry[Method] = Registry(
    "method",
    "trocar.methods",
    {
        "*/policy": Lazy("trocar.learn.agent:POLICY"),
        "*/policy-calibrated": Lazy("trocar.learn.agent:POLICY_CALIBRATED"),
        "*/person": Lazy("trocar.console.person:PERSON"),
        "*/person-calibrated": Lazy("trocar.console.person:PERSON_CALIBRATED"),
    },
    check=_require_method_from_outside,
)
"""Methods from outside a task, as ``TASK/METHOD``, in addition to the task's own. Those of ``*`` do any task."""

PERCEPTIONS: Registry[Any] = Registry("perception", "trocar.perceptions", check=_require_perception)
"""Perceptions from outside a task, as ``TASK/NAME``, in addition to the task's own."""


def methods_of(task: type[Task]) -> tuple[str, ...]:
    """Return the names of all methods of a task: its own, then those from outside.

    Raises:
        InvalidInput: one from outside has the name of one of the task's own.
    """
    return _names(task.methods, METHODS, task.name)


def methods_of_any() -> tuple[str, ...]:
    """Return the names of the methods that do any task: policies and persons."""
    return tuple(name.removeprefix("*/") for name in METHODS if name.startswith("*/"))


def pick_method(task: type[Task], name: str) -> Method:
    """Return the method of this name, or the task's first if the name is empty.

    Raises:
        UnknownName: the task has no method of this name.
    """
    if name in methods_of_any() and name not in task.methods:
        return METHODS[f"*/{name}"]
    method = _pick(task.methods, METHODS, name or next(iter(task.methods)), task.name)
    _require_method(f"{task.name}/{name}", method)
    return method


def perceptions_of(task: type[Task]) -> tuple[str, ...]:
    """Return the names of all perceptions of this task."""
    return _names(task.perceptions, PERCEPTIONS, task.name)


def pick_perception(task: type[Task], name: str) -> Any:
    """Return a new instance of a task's perception.

    Raises:
        UnknownName: the task has no perception of this name.
    """
    return _pick(task.perceptions, PERCEPTIONS, name, task.name)()


def objects_of(task: Task, cell: Cell) -> Callable[[], Objects] | None:
    """Return a function that makes a task's ``Objects`` for policies, with a new perception; None if it has none."""
    kind = type(task)
    if kind.objects is None:
        return None
    perception = next(iter(kind.perceptions), None)

    def make() -> Objects:
        see = None if perception is None else pick_perception(kind, perception)
        return loaded(kind.objects)(cell, task.goals(), task.nominal(), see)

    return make


def _names(own: Mapping[str, Any], registry: Registry[Any], task: str) -> tuple[str, ...]:
    """Return the names of a task's own methods or perceptions, then those from outside, which must differ."""
    outside = [name.removeprefix(f"{task}/") for name in registry if name.startswith(f"{task}/")]
    for name in outside:
        if name in own:
            taken = f"{registry.what} {f'{task}/{name}'!r}"
            raise InvalidInput(taken, "would replace one of the task's own", "register it under another name")
    return (*own, *outside)


def _pick(own: Mapping[str, Any], registry: Registry[Any], name: str, task: str) -> Any:
    names = _names(own, registry, task)
    if name not in names:
        for other in registry:
            elsewhere, _, method = other.partition("/")
            if method == name and elsewhere != "*" and elsewhere not in TASKS:
                problem = f"is of a task that is not registered, {elsewhere!r}"
                raise InvalidInput(f"{registry.what} {other!r}", problem, f"register it as '{task}/{name}'")
        raise UnknownName(f"{task} {registry.what}", name, names)
    return loaded(own[name]) if name in own else registry[f"{task}/{name}"]
