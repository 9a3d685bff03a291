"""A task of your own: touch coloured balls in order.

    trocar run --plugin examples/own_task.py own-task --trials 2 --seed 3 --out out/own-task

This file contains a whole task: scene, world with its referee, score, perception, agent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from trocar.arms import ik
from trocar.cell import Outcome
from trocar.errors import TrocarError
from trocar.eval import TASKS, AgentContext, Method, Score, Task, TaskReport, option, stopped
from trocar.geometry import SE3
from trocar.lab import Station
from trocar.motion import straight
from trocar.perception.depth import pixel_rays
from trocar.perception.image import RgbdImage
from trocar.replay import Viewpoint
from trocar.robots.arm_script import ArmScript
from trocar.sim.record import Record
from trocar.sim.spec import INTANGIBLE, SOLID
from trocar.sim.world import TaskWorld, World

RADIUS_M = 0.004
COLOURS = {"red": (0.85, 0.1, 0.1), "green": (0.1, 0.7, 0.15), "blue": (0.1, 0.2, 0.85), "yellow": (0.85, 0.75, 0.05)}


class TouchOutcome(Outcome):
    """How a touch ended."""

    DONE = "the ball was touched in its turn"
    NOT_SEEN = "the camera saw no ball of that colour"
    MISSED = "the ball was not touched, or not in its turn"


@dataclass(frozen=True, eq=False)
class BallScene:
    """Where the balls truly are: middles (n, 3) in the world, in the order in which they are to be touched."""

    p_world_balls_m: np.ndarray


class BallWorld(TaskWorld):
    """Balls that are fixed to a table, and a referee who notes when an arm touches one."""

    def __init__(self, scene: BallScene):
        self.scene, self.touched_s = scene, {}

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add a table to look at, and the balls."""
        plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "rgba": (0.2, 0.2, 0.2, 1)}
        spec.worldbody.add_geom(name="table", **plane, **INTANGIBLE)
        ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": (RADIUS_M, 0, 0), **SOLID}
        for (colour, rgb), place in zip(COLOURS.items(), self.scene.p_world_balls_m, strict=False):
            spec.worldbody.add_body(pos=place).add_geom(name=f"ball {colour}", rgba=(*rgb, 1), **ball)

    def start(self, world: World) -> None:
        """Look up the balls."""
        self.world = world
        self.balls = {int(world.geoms(f"ball {colour}")[0]): colour for colour in self._colours()}

    def _colours(self) -> list[str]:
        return list(COLOURS)[: len(self.scene.p_world_balls_m)]

    def observe(self, time_s: float) -> None:
        """Note the first time at which an arm touches each ball."""
        for pair in self.world.data.contact.geom[: self.world.data.ncon].tolist():
            for ball, other in (pair, pair[::-1]):
                if ball in self.balls and self.world.geom_arm[other] >= 0:
                    self.touched_s.setdefault(self.balls[ball], time_s)

    def truth(self, record: Record) -> Mapping[str, float]:
        """Return when each ball was touched first."""
        return self.touched_s


class ColourView:
    """Finds a ball by its colour; your own perception is a class like this one."""

    def find(self, image: RgbdImage, colour: str) -> np.ndarray | None:
        """Return the ball's middle (3,) in the camera's frame, or None."""
        rgb = image.color.astype(float) + 1.0
        wanted = np.array(COLOURS[colour]) + 0.02
        likeness = rgb @ wanted / np.linalg.norm(rgb, axis=-1) / np.linalg.norm(wanted)
        seen = (likeness > 0.97) & (rgb.max(-1) > 40) & np.isfinite(image.depth_m)
        if seen.sum() < 12:
            return None
        rays = pixel_rays(image.intrinsics)[seen]
        points = rays * image.depth_m[seen][:, None]
        near = points[np.linalg.norm(points - np.median(points, axis=0), axis=1) < 2 * RADIUS_M]
        middle = near.mean(axis=0)  # of the visible half, two thirds of a radius before the middle
        return middle * (1 + 2 / 3 * RADIUS_M / np.linalg.norm(middle))


@dataclass(frozen=True)
class Settings:
    """How the agent works: heights over a ball's middle in m, budgets on the cell's clock in s."""

    above_m: float = 0.025
    press_m: float = 0.0015
    budget_s: float = 0.1


class Toucher:
    """Looks once, then touches the balls from above, one after the other."""

    def __init__(self, context: AgentContext):
        self.context, self.settings = context, context.settings
        self.hand = ArmScript(context.cell, context.arms[0], settle_s=0.05)

    async def run(self) -> None:
        """Touch the balls in order."""
        cell = self.context.cell
        camera = next(iter(cell.cameras))
        await self.hand.exercise_wrist()
        await self.hand.jaw(0.0)
        with cell.log.span(self.hand.name, "capture"):
            image = await cell.cameras[camera].capture()
        for colour in self.context.goals:
            seen = await self.hand.compute(
                "perception", self.settings.budget_s, lambda colour=colour: self.context.perception.find(image, colour)
            )
            if seen is None:
                cell.log.event("ball", colour=colour, outcome=TouchOutcome.NOT_SEEN.name)
                continue
            p_world = cell.T_world_camera_registered[camera].apply(seen)
            p_base = cell.T_world_base_registered[self.hand.name].inverse().apply(p_world)
            above = p_base + [0.0, 0.0, self.settings.above_m]
            await self.hand.go(ik(self.hand.model, SE3.from_parts(translation_m=above)))
            down = np.array([0.0, 0.0, RADIUS_M - self.settings.press_m - self.settings.above_m])
            for line in (down, -down):
                await self.hand.move(straight(self.hand.model, self.hand.q, line, self.hand.limits))
            cell.log.event("ball", colour=colour, outcome=TouchOutcome.DONE.name)


class BallReport(TaskReport):
    """The usual report, with its own viewpoint for pictures."""

    view = Viewpoint((0.10, -0.34, 0.24))


@dataclass(frozen=True)
class TouchBalls(Task):
    """Up to four balls on a table, to be touched in order."""

    balls: int = option(4, "How many balls.", metavar="N")
    budget_s: float = option(60.0, "A trial that takes longer is stopped.", flag="budget", metavar="S")

    name, about, goal_noun, station = "own-task", "coloured balls, touched in order", "ball", "peg-transfer"
    methods: ClassVar = {
        "calibrated": Method(
            "looks once, then touches from above", Toucher, Settings, calibrated=True, perception="colour"
        )
    }
    perceptions: ClassVar = {"colour": ColourView}
    report = BallReport()

    def __post_init__(self) -> None:
        if not 1 <= self.balls <= len(COLOURS):
            raise TrocarError(f"the number of balls is {self.balls}; give 1 to {len(COLOURS)} with --balls")

    def goals(self) -> tuple[str, ...]:
        """Return the colours in order."""
        return tuple(COLOURS)[: self.balls]

    def scene(self, rng: np.random.Generator, station: Station) -> BallScene:
        """Return balls somewhere on the table, each in a strip of its own."""
        x = np.linspace(-0.03, 0.03, self.balls) + rng.uniform(-0.004, 0.004, self.balls)
        y = rng.uniform(-0.02, 0.02, self.balls)
        return BallScene(np.column_stack([x, y, np.full(self.balls, 0.012)]))

    def world(self, scene: BallScene) -> BallWorld:
        """Return table, balls and referee."""
        return BallWorld(scene)

    def score(self, truth: Mapping[str, float], events: Sequence[Mapping[str, Any]]) -> list[Score]:
        """Return one score for each ball: it counts if all before it were touched before it."""
        scores, before_s = [], 0.0
        given_up, reason = stopped(events)
        for colour in self.goals():
            at_s = truth.get(colour, np.inf)
            done = before_s <= at_s < np.inf
            failure = "" if done else given_up or TouchOutcome.MISSED.name
            why = "" if done else reason
            scores.append(Score(True, done, failure, why, before_s if done else 0.0, at_s if done else 0.0))
            before_s = at_s
        return scores


TASKS.register(TouchBalls.name, TouchBalls)
