"""Phantom and needle in the simulator, with the person who loads it and the referee who watches it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import mujoco
import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.sim.record import Record
from trocar.sim.world import TaskWorld, World
from trocar.tasks.suture.scene import SutureScene
from trocar.tasks.suture.score import NeedleTruth
from trocar.tasks.suture.world.needle import HeldNeedle, add_phantom

LOADING_S = 1.0
"""Time that a person takes to load the needle (assumed; reported as a separate part)."""


class SutureWorld(TaskWorld):
    """A phantom that collides with nothing, and a needle held by jaws, tissue, or a person."""

    def __init__(self, scene: SutureScene, arm: str):
        self._scene, self._arm = scene, arm
        self._loads = cycle(scene.T_needle_loaded)
        self._gripped: list[bool] = []
        self._in_hand: list[bool] = []

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add phantom, circle and needle."""
        add_phantom(spec, self._scene)

    def start(self, world: World) -> None:
        """Put the needle into a person's hand."""
        self._world = world
        self._needle = HeldNeedle(world, self._scene, self._arm)

    def act(self) -> None:
        """Hold the needle when the jaws do not."""
        self._needle.act()

    def observe(self, time_s: float) -> None:
        """Note who holds the needle."""
        del time_s
        self._gripped.append(self._needle.gripped())
        self._in_hand.append(self._needle.in_hand)

    def truth(self, record: Record) -> NeedleTruth:
        """Return needle and tip in the circle's frame, and who held the needle."""
        T_circle_world = self._scene.T_world_circle.inverse()
        return NeedleTruth(
            times_s=record.times_s,
            T_circle_needle=T_circle_world @ record.T_world_body["needle"],
            T_circle_tip=T_circle_world @ record.T_world_tip[self._arm],
            gripped=np.array(self._gripped),
            in_hand=np.array(self._in_hand),
            p_needle_tip_m=self._scene.needle.p_tip_m,
        )

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return where the circle truly was."""
        del record
        return {"T_world_circle": self._scene.T_world_circle.matrix}

    def assistants(self) -> Mapping[str, Any]:
        """Return the person who loads the needle, wherever the jaws truly are."""
        return {"load needle": self._load}

    async def _load(self, arm: str) -> None:
        """Put the needle between the open jaws, about in the agreed grasp, and hold it there until they close."""
        await trio.sleep(LOADING_S)
        world = self._world
        T_world_tip = world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm))
        self._needle.give(T_world_tip @ self._scene.T_tip_needle @ next(self._loads))
