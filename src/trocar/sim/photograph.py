"""Pictures of a trial for people; no agent gets them."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.perception.image import Intrinsics
from trocar.scene import Scene, SutureScene
from trocar.sim.camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.sim.world import World

LENS = Intrinsics(640, 480, 1520.0, 1520.0, 319.5, 239.5)
VIEWS = {
    Scene: ((0.13, -0.46, 0.33), (0.004, 0.0, 0.030), 0.95),
    SutureScene: ((0.12, 0.23, 0.17), (-0.002, 0.0, 0.008), 0.37),
}
"""Where the eye stands and where it looks, in the world, and the light's gain: nearer is brighter; by type of scene."""
AMBIENT = 0.42
TABLE_RGB = (0.30, 0.33, 0.36)
BLOCK_RGB = (0.86, 0.55, 0.13)
SHAFT_RGB = (0.20, 0.21, 0.24)
NEEDLE_RGB = (0.05, 0.25, 0.85)


class Photographer:
    """Draws a world in states that it was in, brighter than the sensor sees it, the blocks told apart by colour."""

    def __init__(self, world: World):
        model = copy.copy(world.model)
        for g in range(model.ngeom):
            name = model.geom(g).name
            if name == "table":
                model.geom_rgba[g, :3] = TABLE_RGB
            elif name.startswith("block"):
                model.geom_rgba[g, :3] = BLOCK_RGB
            elif name.startswith("needle"):
                model.geom_rgba[g, :3] = NEEDLE_RGB
            elif name.endswith("_shaft"):
                model.geom_rgba[g, :3] = SHAFT_RGB
        eye_m, target_m, gain = VIEWS[type(world.cell.scene)]
        light = Light(ambient=AMBIENT, gain=gain)
        flaws = replace(SensorFlaws.none(), shadow=True)
        self._data = mujoco.MjData(model)
        self._camera = RayCamera(model, LENS, look_at(np.array(eye_m), np.array(target_m)), flaws, light)

    def picture(self, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3) of the world with these positions (nq,)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._camera.model, self._data)
        return self._camera.render(self._data, np.random.default_rng(0)).color


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64]) -> SE3:
    """Return ``T_world_camera`` (OpenCV axes) of a level camera at ``eye_m`` that looks at ``target_m``."""
    z = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3(np.column_stack([x, np.cross(z, x), z])), eye_m)
