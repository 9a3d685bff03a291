"""A task for learners: touch a ball in the air, which the camera finds. It is the own task of ``examples/``, with one.

trocar run reach --plugin benchmarks/reach.py --trials 2
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from trocar.cell import Cell
from trocar.eval import TASKS
from trocar.lab import Station
from trocar.perception.depth import project
from trocar.perception.image import Window

sys.path.append(str(Path(__file__).parents[1] / "examples"))
import own_task  # registers a task

PLACES_M = np.array([[0.0, -0.02, 0.03], [0.06, 0.04, 0.07]])
"""Corners, in the world, of the box in which a ball is; the tip begins at (85, 45, 80) mm (assumed)."""
MARGIN_PX = 20
"""Of the part of the image that is looked at, about what is seen of that box."""


class BallWorld(own_task.BallWorld):
    """The balls, with what a dense reward needs."""

    def errand(self, goal: str) -> tuple[np.ndarray, np.ndarray]:
        """Return where a ball is: it stays there."""
        place = self.scene.p_world_balls_m[list(own_task.COLOURS).index(goal)]
        return place, place


class BallObjects:
    """What policies see: the middle of each ball in the world, m, as last seen; 0 before that."""

    def __init__(self, cell: Cell, goals: Sequence[str], nominal: None, perception: Any):
        self.cell, self.goals, self.see = cell, goals, perception
        self.names = [f"{colour}.{axis}" for colour in goals for axis in "xyz"]
        self.values = np.zeros(3 * len(goals))

    async def watch(self) -> None:
        """Look twice a second until all were seen; they stay where they are."""
        name, camera = next(iter(self.cell.cameras.items()))
        corners = self.cell.T_world_camera_registered[name].inverse().apply(np.array(list(product(*PLACES_M.T))))
        seen_px = project(camera.model, corners)
        low, high = (edge.astype(int) for edge in (seen_px.min(0) - MARGIN_PX, seen_px.max(0) + MARGIN_PX))
        window = Window(tuple(low.tolist()), tuple((high - low).tolist()))  # rendering all of it would take a second
        while not self.values.all():
            image = await camera.capture(window)
            for number, colour in enumerate(self.goals):
                seen = self.see.find(image, colour)
                if seen is not None:
                    place = self.cell.T_world_camera_registered[name].apply(seen)
                    self.values[3 * number : 3 * number + 3] = place
            await self.cell.clock.sleep(0.5)


@dataclass(frozen=True)
class Reach(own_task.TouchBalls):
    """One ball in the air, where the arm gets without turning its tool."""

    balls: int = 1
    name, about, objects = "reach", "a ball in the air, touched where the camera finds it", BallObjects

    def scene(self, rng: np.random.Generator, station: Station) -> own_task.BallScene:
        """Return a ball somewhere over the table."""
        return own_task.BallScene(rng.uniform(*PLACES_M, (self.balls, 3)))

    def world(self, scene: own_task.BallScene) -> BallWorld:
        """Return table, ball and referee."""
        return BallWorld(scene)


TASKS.register(Reach.name, Reach)
