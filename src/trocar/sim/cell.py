"""A whole simulated cell: world, arms, camera, referee, on one virtual clock."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace

import mujoco
import numpy as np
import trio
from numpy.typing import NDArray
from trio.testing import MockClock

from trocar.arms import ik
from trocar.geometry import SE3, SO3
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


PICTURE = Intrinsics(640, 480, 1250.0, 1250.0, 319.5, 239.5)
PICTURE_EYE_M = (0.20, -0.42, 0.34)
PICTURE_TARGET_M = (0.006, 0.0, 0.028)
"""Where the storyboard is seen from; no agent gets these pictures."""


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


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64]) -> SE3:
    """Return ``T_world_camera`` (OpenCV axes) of a level camera at ``eye_m`` that looks at ``target_m``."""
    z = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3(np.column_stack([x, np.cross(z, x), z])), eye_m)


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

    def picture(self, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3) of the world in an earlier state; the world stays as it is."""
        data = mujoco.MjData(self.world.model)
        data.qpos[:] = qpos
        mujoco.mj_forward(self.world.model, data)
        flaws = replace(SensorFlaws.none(), shadow=True)
        eye, target = np.array(PICTURE_EYE_M), np.array(PICTURE_TARGET_M)
        rays = RayCamera(self.world.model, PICTURE, look_at(eye, target), flaws)
        return rays.render(data, np.random.default_rng(0)).color

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
