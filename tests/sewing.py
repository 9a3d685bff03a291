"""Sutures in an ideal cell: its laboratory, and the context of its agent."""

from __future__ import annotations

import numpy as np

from simulated import ideal_session
from trocar.cell import Cell
from trocar.eval import AgentContext
from trocar.lab import SensorFlaws, Station
from trocar.motion import PLANNERS
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.suture.agents.circle import Settings
from trocar.tasks.suture.task import CircleSutures


def sewing_laboratory(
    task: CircleSutures, station: Station, scene: tuple | None = None, flawed: bool = False
) -> SimLaboratory:
    """Return an ideal session's laboratory, over this scene or one of the task's; ``flawed``: with camera flaws."""
    world = task.world(scene or task.scene(np.random.default_rng(0), station))
    flaws = None if flawed else SensorFlaws.none()
    return SimLaboratory(ideal_session(station), world, np.random.default_rng(0), flaws=flaws)


def briefed(cell: Cell, sutures: tuple, settings: Settings, arms: tuple[str, ...] = ("psm1",)) -> AgentContext:
    """Return the context of an agent in this cell."""
    return AgentContext(cell, sutures, None, arms, PLANNERS["spline"], None, np.random.default_rng(0), settings)
