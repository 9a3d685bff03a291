"""What a policy observes of a cell at each moment, in an environment, as an agent, and beside a scripted expert."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.errors import InvalidInput, UnknownName
from trocar.eval.method import Agent, AgentContext, begun
from trocar.eval.objects import Objects
from trocar.learn.control import ABSOLUTE, IMAGES, OBJECTS, STATE, Control, Eyes

SEEN = (STATE, OBJECTS, IMAGES)
"""Parts of an observation that need no truth."""
NOTED = "observed"
"""Name of the event that lists the names of the objects' numbers."""
PREFIX = "observed_"
"""Prefix of the arrays of noted observations in a trial: ``observed_state``, ``observed_objects``."""


class Observation:
    """What a policy observes of a running cell.

    Args:
        cell: the cell.
        control: control of the arms.
        parts: which of ``SEEN`` are observed.
        objects: makes the task's ``Objects``; called only if objects are observed.
    """

    def __init__(self, cell: Cell, control: Control, parts: Sequence[str], objects: Callable[[], Objects] | None):
        for part in parts:
            if part not in SEEN:
                raise UnknownName("observation", part, SEEN)
        self._cell, self._control, self._parts = cell, control, tuple(parts)
        if OBJECTS in parts and objects is None:
            problem = "is nothing in this task, which does not say what policies see of its objects"
            raise InvalidInput(f"observation {OBJECTS!r}", problem, f"observe {IMAGES!r}, or give it Task.objects")
        self.eyes = Eyes(cell) if IMAGES in parts else None
        self.objects = objects() if objects is not None and OBJECTS in parts else None

    @property
    def looks(self) -> bool:
        """Return whether it needs images."""
        return self.eyes is not None or self.objects is not None

    async def watch(self, cell: Cell) -> None:
        """Take the images that are needed, until cancelled."""
        async with trio.open_nursery() as nursery:
            if self.eyes is not None:
                nursery.start_soon(self.eyes.watch)
            if self.objects is not None:
                nursery.start_soon(self.objects.watch)
            await trio.sleep_forever()  # a stepped cell ends with this script; `watch` of objects may end early

    def now(self) -> dict[str, NDArray[Any]]:
        """Return the observation of this moment."""
        seen: dict[str, NDArray[Any]] = dict(self._control.observe()) if STATE in self._parts else {}
        if self.objects is not None:
            seen[OBJECTS] = self.objects.values.astype(np.float32)
        if self.eyes is not None:
            seen |= self.eyes.observe()
        return seen | {"time_s": np.array([self._cell.clock.now_s()], np.float32)}


class Observed:
    """Runs an agent and notes, 30 times per second, what a policy would observe.

    Args:
        agent: the agent that does the task.
        context: the agent's context.
    """

    def __init__(self, agent: Agent, context: AgentContext):
        self._agent, self._cell = agent, context.cell
        parts = (STATE, OBJECTS) if context.objects is not None else (STATE,)
        self._control = Control(context.cell, context.arms, ABSOLUTE)
        self._observation = Observation(context.cell, self._control, parts, context.objects)

    async def run(self) -> None:
        """Let the agent do the task."""
        objects = self._observation.objects
        self._cell.log.event(NOTED, objects=[] if objects is None else list(objects.names))
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._observation.watch, self._cell)
            nursery.start_soon(self._note)
            await begun(self._agent)
            nursery.cancel_scope.cancel()

    async def _note(self) -> None:
        while True:
            seen = self._observation.now()
            for name in (STATE, OBJECTS):
                if name in seen:
                    self._cell.log.sample(PREFIX + name, seen[name])
            await self._control.step()
