"""A station's cameras in a simulated world: one lens or a pair, behind the ``Camera`` protocol."""

from __future__ import annotations

from contextlib import nullcontext

import mujoco
import numpy as np
import trio

from trocar.geometry import SE3
from trocar.lab import SensorFlaws, StationCamera
from trocar.perception.image import Image, Intrinsics, StereoImage, StereoRig, StereoWindow, Window, read_out
from trocar.sim.appearance import Appearance
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.world import World

STEREO_GAINS = (1.0, 0.96)
"""Gains of the left and the right sensor of a pair; real ones are never equally bright (assumed)."""


class CameraRenderer:
    """Renders what a camera of a station sees of a world.

    Args:
        model: MuJoCo's model of the world.
        camera: the camera, with its true lenses, lamp, gain and flaws; images carry the lenses as registered.
        T_world_camera: true pose (of a pair: of the left camera).
        flaws: override the camera's own.

    Attributes:
        model: the lens or lenses as registered.
        lenses: one ray camera, or the left and the right one of a pair.
    """

    def __init__(
        self, model: mujoco.MjModel, camera: StationCamera, T_world_camera: SE3, flaws: SensorFlaws | None = None
    ):
        light, flaws = Light(ambient=camera.ambient, gain=camera.gain), flaws or camera.flaws
        true, lamp = camera.model, np.array(camera.lamp_m)
        if isinstance(true, StereoRig):
            looks, lamp_right = Appearance(model), true.T_left_right.inverse().apply(lamp)
            self.lenses = [
                RayCamera(model, true.left, T_world_camera, lamp, flaws, light, looks),
                RayCamera(model, true.right, T_world_camera @ true.T_left_right, lamp_right, flaws, light, looks),
            ]
        else:
            self.lenses = [RayCamera(model, true, T_world_camera, lamp, flaws, light)]
        self.model = camera.model_registered
        self._binned = {1: self.lenses}

    def image(
        self, data: mujoco.MjData, rng: np.random.Generator, window: Window | StereoWindow | None = None
    ) -> Image:
        """Return an image of the world in this state, or of a window of it.

        Raises:
            InvalidInput: the window is for another kind of camera.
        """
        model = read_out(self.model, window)
        windows = [window.left, window.right] if isinstance(window, StereoWindow) else [window] * len(self.lenses)
        by = window.binning if isinstance(window, StereoWindow) else 1
        if by not in self._binned:
            self._binned[by] = [lens.binned(by) for lens in self.lenses]
        lenses = []
        for lens, part in zip(self._binned[by], windows, strict=True):
            if part is None:
                lenses.append(lens)
            else:
                (u, v), (width, height) = part.corner_px, part.size_px
                lenses.append(lens.cropped(data, (u // by, v // by), (width // by, height // by)))
        if isinstance(model, StereoRig):
            left, right = (lens.render_color(data, rng, gain) for lens, gain in zip(lenses, STEREO_GAINS, strict=True))
            return StereoImage(left, right, model, float(data.time))
        return lenses[0].render(data, rng)


class SimCamera:
    """A simulated camera behind the ``Camera`` protocol.

    Attributes:
        renderer: renders its images.
        exposure_s: exposure of one image.
        rng: random numbers for its noise.
        model: its lens or lenses as registered.
        taken: all images that it took without a window.
        rendering: whether it renders one now.
    """

    def __init__(self, world: World, renderer: CameraRenderer, exposure_s: float, rng: np.random.Generator):
        self._world, self.renderer, self.exposure_s, self.rng = world, renderer, exposure_s, rng
        self.model = renderer.model
        self.taken: list[Image] = []
        self.rendering = False
        # A projector lights one exposure at a time; a pair of lenses streams, and exposures may overlap.
        self._exposures = trio.Lock() if isinstance(self.model, Intrinsics) else nullcontext()

    async def capture(self, window: Window | StereoWindow | None = None) -> Image:
        """Expose one image; it shows the end of the exposure."""
        read_out(self.model, window)  # raises before any time passes
        async with self._exposures:
            await trio.sleep(self.exposure_s)
        self.rendering = True
        try:
            image = self.renderer.image(self._world.data, self.rng, window)
        finally:
            self.rendering = False
        if window is None:
            self.taken.append(image)
        return image
