"""How a task is done: an agent, and what it is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from trocar.cell import Cell, Robot
from trocar.errors import TrocarError
from trocar.eval.task import Task
from trocar.motion.plan import Planner
from trocar.registry import Lazy, Registry


class Agent(Protocol):
    """A script that tries to reach a task's goals."""

    async def run(self) -> None:
        """Do it; return when there is nothing left to do."""
        ...


@dataclass(frozen=True, eq=False)
class AgentContext:
    """What an agent is given.

    Attributes:
        cell: devices, and what registration found.
        goals: what is to be done, in order.
        nominal: what is known about the scene beforehand, such as shapes; defined by the task.
        arms: names of those that work.
        planner: of its motions.
        perception: turns images into poses; None if the task has none.
        rng: its own stream of randomness.
        settings: of its method.
    """

    cell: Cell
    goals: Sequence[Any]
    nominal: Any
    arms: tuple[str, ...]
    planner: Planner
    perception: Any
    rng: np.random.Generator
    settings: Any


@dataclass(frozen=True)
class Method:
    """One way to do a task.

    Attributes:
        about: one line.
        agent: class of its agent, or any function of a brief; lazy where importing it is expensive.
        settings: class of its settings, whose default values are used. Lazy likewise.
        calibrated: whether the arms' cables are compensated by a fitted model.
        learns: whether the arms' cables are compensated by models that start from a prior alone, and the agent lets its
            robot (``trocar.robots.Adaptive``) learn; then it is not ``calibrated``.
        wrap_robot: the robot's extra wrapper for its agent: a function of the cell and the method's settings that
            returns a robot; None: no wrapper. A guard uses its estimates if it is a ``JointEstimator``.
        stop_at_limits: whether a motion is refused whose compensation would leave a joint's range; else what cannot
            be corrected stays uncorrected.
        planner: name in ``PLANNERS``, if none is asked for.
        perception: name among the task's, if none is asked for; empty where it has none.
    """

    about: str
    agent: Callable[[AgentContext], Agent] | Lazy
    settings: Callable[[], Any] | Lazy
    calibrated: bool = True
    learns: bool = False
    wrap_robot: Callable[[Cell, Any], Robot] | Lazy | None = None
    stop_at_limits: bool = False
    planner: str = "spline"
    perception: str = ""

    def made(self, context: AgentContext) -> Agent:
        """Return an agent with its context."""
        return _loaded(self.agent)(context)

    def wrapped(self, cell: Cell, settings: Any) -> Robot:
        """Return the cell's robot with this method's wrapper."""
        return cell.robot if self.wrap_robot is None else _loaded(self.wrap_robot)(cell, settings)

    def default_settings(self) -> Any:
        """Return the default settings."""
        return _loaded(self.settings)()


METHODS: Registry[Method] = Registry("method", "trocar.methods")
"""Methods from outside, as ``TASK/METHOD``; a task has its own besides."""

PERCEPTIONS: Registry[Any] = Registry("perception", "trocar.perceptions")
"""Perceptions from outside, as ``TASK/NAME``; a task has its own besides."""


def methods_of(task: type[Task]) -> dict[str, Method | Lazy]:
    """Return all methods of a task by name: its own, then those from outside.

    Raises:
        TrocarError: one from outside has the name of one of its own.
    """
    return _together(task.methods, METHODS, task.name)


def pick_method(task: type[Task], name: str) -> Method:
    """Return the method of this name; empty: the task's first.

    Raises:
        TrocarError: the task has none of that name.
    """
    name = name or next(iter(task.methods))
    method = _pick(methods_of(task), name, "method", task.name)
    if not isinstance(method, Method):
        raise TrocarError(f"method {name!r} of {task.name} is {method!r}; register a trocar.eval.Method")
    return method


def pick_perception(task: type[Task], name: str) -> Any:
    """Return a new instance of this task's perception.

    Raises:
        TrocarError: the task has none of that name.
    """
    return _pick(_together(task.perceptions, PERCEPTIONS, task.name), name, "perception", task.name)()


def perceptions_of(task: type[Task]) -> tuple[str, ...]:
    """Return the names of all perceptions of this task."""
    return tuple(_together(task.perceptions, PERCEPTIONS, task.name))


def _together(own: Mapping[str, Any], registry: Registry[Any], task: str) -> dict[str, Any]:
    """Return all entries of a kind for a task: its own, then those from outside, under other names."""
    outside = _from_outside(registry, task)
    for name in outside:
        if name in own:
            taken = f"{registry.what} {task + '/' + name!r}"
            raise TrocarError(f"{taken} would replace one of the task's own; register it under another name")
    return {**own, **outside}


def _from_outside(registry: Registry[Any], task: str) -> dict[str, Lazy]:
    prefix = f"{task}/"
    return {name.removeprefix(prefix): _Deferred(registry, name) for name in registry if name.startswith(prefix)}


@dataclass(frozen=True)
class _Deferred(Lazy):
    """An entry of a registry that is loaded when it is picked."""

    registry: Registry[Any]
    where: str

    def __init__(self, registry: Registry[Any], where: str):
        object.__setattr__(self, "registry", registry)
        object.__setattr__(self, "where", where)

    def load(self) -> Any:
        return self.registry[self.where]


def _pick(choices: Mapping[str, Any], name: str, what: str, task: str) -> Any:
    if name not in choices:
        known = ", ".join(choices) or "none"
        raise TrocarError(f"{what} {name!r} of {task} is unknown; choose one of {known}")
    return _loaded(choices[name])


def _loaded(thing: Any) -> Any:
    return thing.load() if isinstance(thing, Lazy) else thing
