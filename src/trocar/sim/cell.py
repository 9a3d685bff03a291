"""A whole simulated cell: world, arms, camera, referee, on one virtual clock."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import numpy as np
import trio
from numpy.typing import NDArray
from trio.testing import MockClock

from trocar.arms import ArmModel, fk, ik, wrist_depth_m
from trocar.geometry import SE3
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.scene import Scene, SutureScene
from trocar.sim.camera import ZIVID, RayCamera, nominal_camera
from trocar.sim.mjcf import CellModel
from trocar.sim.needle import HeldNeedle
from trocar.sim.needle_referee import NeedleReferee
from trocar.sim.referee import Referee
from trocar.sim.robot import SimRobot
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.sim.session import Session
from trocar.sim.transmission import Transmission
from trocar.sim.world import World

EXPOSURE_S = 0.143
"""One RGBD image: the paper's .241 s of perception a block less its .098 s of registration and grasp planning."""

BINNING = 2
"""Pixels are taken 2 x 2, as the sensor's fast mode does: .43 mm a pixel on the board."""

PARK_M = {"psm1": (0.085, 0.045, 0.080), "psm2": (-0.085, 0.045, 0.080)}
"""Tips at the start, in the world: beside the board, out of the camera's view of the pegs."""

ABOVE_SAFE_DEPTH_M = 1e-3
"""Over a circle of sutures the arm rests with its joints in their middle and its wrist this much below the depth that
is safe."""

LOADING_S = 1.0
"""What a person takes to load the needle (assumed; the time is a part of its own)."""

PARK_JAW_RAD = 0.1
REST_S = 0.5
"""The blocks come to rest for so long before the clock starts."""


class SimCamera:
    """The simulated RGBD camera behind the ``Camera`` protocol."""

    def __init__(self, world: World, rays: RayCamera, intrinsics: Intrinsics, rng: np.random.Generator):
        self._world, self._rays, self._rng = world, rays, rng
        self.intrinsics = intrinsics

    async def capture(self) -> RgbdImage:
        """Expose one image; it shows the end of the exposure."""
        await trio.sleep(EXPOSURE_S)
        image = self._rays.render(self._world.data, self._rng)
        return RgbdImage(image.color, image.depth_m, image.intrinsics, trio.current_time())


class SimAssistant:
    """A person with the needle behind the ``Assistant`` protocol: loads exactly, wherever the jaws truly are."""

    def __init__(self, world: World, scene: SutureScene, needle: HeldNeedle):
        self._world, self._scene, self._needle = world, scene, needle

    async def load(self, arm: str) -> None:
        """Put the needle between the jaws."""
        await trio.sleep(LOADING_S)
        cell = self._world.cell
        T_world_tip = cell.T_world_base[arm] @ fk(cell.arms[arm], self._world.joints(arm))
        self._needle.give(T_world_tip @ self._scene.T_tip_needle)


class SimulatedCell:
    """One trial's world, ready to run a script.

    Attributes:
        world: the physics. For the referee and the tests.
        robot: the arms.
        camera: the RGBD camera.
        referee: what really happened.
        assistant: who hands out the needle; None where there is none.
        T_world_camera: pose of the camera; the world's frame is what the laboratory's registration refers to.
    """

    def __init__(
        self, session: Session, scene: Scene | SutureScene, rng: np.random.Generator, flaws: SensorFlaws | None = None
    ):
        self.session = session
        self.world = World(CellModel(scene, session.arms, session.T_world_base))
        self._clock = MockClock()
        self.robot = SimRobot(self.world, self._clock)
        cable_rng, camera_rng = rng.spawn(2)
        for name, arm in session.arms.items():
            q_cmd = self._start(name, arm)
            cables = Transmission(session.plants[name], q_cmd, cable_rng)
            self.robot.attach(name, cables, q_cmd, PARK_JAW_RAD)
        self.assistant, self.referee = self._watched()
        self.world.settle(REST_S)
        self.T_world_camera = nominal_camera()
        intrinsics = ZIVID.binned(BINNING)
        rays = RayCamera(self.world.model, intrinsics, self.T_world_camera, flaws or SensorFlaws())
        self.camera = SimCamera(self.world, rays, intrinsics, camera_rng)

    def _start(self, name: str, arm: ArmModel) -> NDArray[np.float64]:
        """Return where (6,) an arm rests before its script: beside the pegboard, or high over the circle."""
        if isinstance(self.world.cell.scene, SutureScene):
            q = arm.middle.copy()
            q[2] += arm.safe_depth_m + ABOVE_SAFE_DEPTH_M - float(wrist_depth_m(arm, q))
            return q
        p_base_tip = self.session.T_world_base[name].inverse().apply(PARK_M[name])
        return ik(arm, SE3.from_parts(translation_m=p_base_tip))

    def _watched(self) -> tuple[SimAssistant | None, Referee | NeedleReferee]:
        """Return who helps in this scene and who judges it."""
        if not isinstance(self.world.cell.scene, SutureScene):
            return None, Referee(self.world)
        needle = HeldNeedle(self.world, self.world.cell.scene)
        self.world.effects.append(needle.act)
        (arm,) = self.session.arms
        return SimAssistant(self.world, self.world.cell.scene, needle), NeedleReferee(self.world, needle, arm)

    def run(self, script: Callable[[], Awaitable[None]], budget_s: float) -> bool:
        """Run a script to its end on the virtual clock; return whether it ended within its budget.

        However it ends, the arms hold where they are then.

        Raises:
            Whatever the script raises, out of the groups that nurseries put it in; an interruption before all else.
        """
        try:
            return trio.run(self._run, script, budget_s, clock=self._clock)
        except BaseExceptionGroup as group:
            raise _cause(group) from None

    async def _run(self, script: Callable[[], Awaitable[None]], budget_s: float) -> bool:
        ended = False
        try:
            with trio.move_on_after(budget_s):
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(self.robot.run_physics, self.referee.observe)
                    await script()
                    ended = True
                    nursery.cancel_scope.cancel()
        finally:
            for arm in self.session.arms:
                self.robot.hold(arm)
        return ended


def _cause(group: BaseExceptionGroup) -> BaseException:
    """Return what a nursery's group of exceptions is about: an interruption, or else the first."""
    leaves: list[BaseException] = []
    rest: list[BaseException] = [group]
    while rest:
        error = rest.pop(0)
        if isinstance(error, BaseExceptionGroup):
            rest.extend(error.exceptions)
        else:
            leaves.append(error)
    return next((leaf for leaf in leaves if not isinstance(leaf, Exception)), leaves[0])
