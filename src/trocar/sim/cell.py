"""A whole simulated cell: world, arms, camera, referee, on one virtual clock."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import numpy as np
import trio
from trio.testing import MockClock

from trocar.arms import ik
from trocar.geometry import SE3
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.scene import Scene
from trocar.sim.camera import ZIVID, RayCamera, nominal_camera
from trocar.sim.mjcf import CellModel
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


class SimulatedCell:
    """One trial's world, ready to run a script.

    Attributes:
        world: the physics. For the referee and the tests.
        robot: the arms.
        camera: the RGBD camera.
        referee: what really happened.
        T_world_camera: pose of the camera; the world's frame is what the laboratory's registration refers to.
    """

    def __init__(self, session: Session, scene: Scene, rng: np.random.Generator, flaws: SensorFlaws | None = None):
        self.session = session
        self.world = World(CellModel(scene, session.arms, session.T_world_base))
        self._clock = MockClock()
        self.robot = SimRobot(self.world, self._clock)
        cable_rng, camera_rng = rng.spawn(2)
        for name, arm in session.arms.items():
            p_base_tip = session.T_world_base[name].inverse().apply(PARK_M[name])
            q_cmd = ik(arm, SE3.from_parts(translation_m=p_base_tip))
            cables = Transmission(session.plants[name], q_cmd, cable_rng)
            self.robot.attach(name, cables, q_cmd, PARK_JAW_RAD)
        self.world.settle(REST_S)
        self.T_world_camera = nominal_camera()
        intrinsics = ZIVID.binned(BINNING)
        rays = RayCamera(self.world.model, intrinsics, self.T_world_camera, flaws or SensorFlaws())
        self.camera = SimCamera(self.world, rays, intrinsics, camera_rng)
        self.referee = Referee(self.world)

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
