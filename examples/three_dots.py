"""The smallest task of your own: three dots, to be touched in order.

trocar run dots --plugin examples/three_dots.py --trials 2 --seed 4
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from mujoco import mjtGeom

from trocar.arms import ik
from trocar.eval import TASKS, Method, Score, Task, stopped
from trocar.geometry import SE3
from trocar.motion import straight
from trocar.robots.arm_script import ArmScript
from trocar.sim.spec import SOLID
from trocar.sim.world import TaskWorld

RADIUS_M = 0.005
DRAWN_M = np.array([[-0.02, 0.0, RADIUS_M], [0.0, 0.01, RADIUS_M], [0.02, 0.0, RADIUS_M]])  # middles, in the world


class DotWorld(TaskWorld):
    """The simulator's side of a scene: the dots, and a referee who notes when each is first touched."""

    def __init__(self, places_m):
        self.places_m, self.touched_s = places_m, {}

    def add(self, spec):
        for k, place in enumerate(self.places_m):
            dot = spec.worldbody.add_body(pos=place)
            dot.add_geom(name=f"dot {k}", type=mjtGeom.mjGEOM_SPHERE, size=(RADIUS_M, 0, 0), **SOLID)

    def start(self, world):
        self.data = world.data
        self.dots = {int(world.geoms(f"dot {k}")[0]): k for k in range(len(self.places_m))}

    def observe(self, time_s):
        for dot in self.dots.keys() & set(self.data.contact.geom[: self.data.ncon].ravel().tolist()):
            self.touched_s.setdefault(self.dots[dot], time_s)

    def errand(self, goal):
        return self.places_m[goal], self.places_m[goal]

    def truth(self, record):
        return self.touched_s


class Toucher:
    """The agent: moves above each dot of the drawing, straight down, and up again."""

    def __init__(self, context):
        self.context = context
        self.hand = ArmScript(context.cell, context.arms[0], settle_s=0.05)

    async def run(self):
        T_base_world = self.context.cell.T_world_base_registered[self.hand.name].inverse()
        await self.hand.jaw(0.0)
        for k in self.context.goals:
            above = T_base_world.apply(DRAWN_M[k]) + [0.0, 0.0, 0.02]
            await self.hand.go(ik(self.hand.model, SE3.from_parts(translation_m=above)))
            for line_m in (np.array([0.0, 0.0, -0.019]), np.array([0.0, 0.0, 0.019])):
                await self.hand.move(straight(self.hand.model, self.hand.q, line_m, self.hand.limits))


@dataclass(frozen=True)
class Dots(Task):
    """Three dots, printed up to a millimetre off their drawing, to be touched in order."""

    budget_s: float = 60.0
    name, about, goal_noun, station = "dots", "three dots, touched in order", "dot", "peg-transfer"
    methods: ClassVar = {"drawing": Method("goes where the drawing has them", Toucher)}

    def goals(self):
        return (0, 1, 2)

    def scene(self, rng, station):
        return DRAWN_M + rng.uniform(-1e-3, 1e-3, (3, 3)) * [1, 1, 0]

    def world(self, scene):
        return DotWorld(scene)

    def score(self, truth, events):
        times_s = [0.0, *(truth.get(k, np.inf) for k in self.goals())]
        done = [before <= at < np.inf for before, at in pairwise(times_s)]
        given_up, reason = stopped(events)  # empty, unless the whole script was stopped
        return [
            Score(True, ok, "" if ok else given_up or "MISSED", "" if ok else reason, 0.0, at if ok else 0.0)
            for ok, at in zip(done, times_s[1:], strict=True)
        ]


TASKS.register(Dots.name, Dots)
