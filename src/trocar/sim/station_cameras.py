"""The eyes of a station's camera in a simulated world."""

from __future__ import annotations

import mujoco
import numpy as np

from trocar.geometry import SE3
from trocar.lab import SensorFlaws, StationCamera
from trocar.perception.image import StereoRig
from trocar.sim.appearance import Appearance
from trocar.sim.camera import RayCamera
from trocar.sim.sensor import Light

EYE_GAINS = (1.0, 0.96)
"""Gains of the left and the right eye of a pair, since two sensors are never equally bright (assumed)."""


def eyes_of(
    model: mujoco.MjModel, camera: StationCamera, T_world_camera: SE3, flaws: SensorFlaws | None = None
) -> list[RayCamera]:
    """Return one eye of an RGBD camera, or the left and the right one of a pair.

    Args:
        model: the world that they see.
        camera: its true lenses, lamp, gain and flaws.
        T_world_camera: true pose (of a pair: of the left one).
        flaws: in place of the camera's.
    """
    light = Light(ambient=camera.ambient, gain=camera.gain)
    flaws = flaws or camera.flaws
    lens, lamp = camera.model, np.array(camera.lamp_m)
    if not isinstance(lens, StereoRig):
        return [RayCamera(model, lens, T_world_camera, lamp, flaws, light)]
    finish, lamp_right = Appearance(model), lens.T_left_right.inverse().apply(lamp)
    return [
        RayCamera(model, lens.left, T_world_camera, lamp, flaws, light, finish),
        RayCamera(model, lens.right, T_world_camera @ lens.T_left_right, lamp_right, flaws, light, finish),
    ]
