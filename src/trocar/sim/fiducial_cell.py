"""One arm of the simulated cell during calibration: it wears a fixture, the other arms are withdrawn."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.lab import SensorFlaws
from trocar.lab.session import Session
from trocar.perception.fiducials import Fixture
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.sim.camera import RayCamera
from trocar.sim.elements import NOTHING, add, text
from trocar.sim.fixture import printed
from trocar.sim.mjcf import CellModel
from trocar.sim.sensor import Light
from trocar.sim.task_world import TaskWorld
from trocar.sim.world import World

TABLE_RGB = (0.05, 0.05, 0.05)
TABLE_BELOW_M = 0.08
"""The black table, cleared for the calibration, lies this much below the world's origin (assumed)."""


class EmptyTable(TaskWorld):
    """A table with nothing on it."""

    def add(self, world: Element, assets: Element) -> None:
        """Add it, black, far below the world's origin."""
        add(
            world,
            "geom",
            name="table",
            type="plane",
            size="2 2 0.01",
            pos=text((0.0, 0.0, -TABLE_BELOW_M)),
            rgba=text((*TABLE_RGB, 1)),
            **NOTHING,
        )


class FiducialCell:
    """Takes images of an arm at rest that wears painted spheres. Simulator truth; estimators get only its images.

    Args:
        session: the session; its true base and camera are used.
        arm: which arm.
        camera: which of the station's cameras.
        fixture: that the arm wears, as designed; its printing errors are drawn.
        rng: draws the printing errors.
        flaws: of the camera, in place of the station's.
    """

    def __init__(
        self,
        session: Session,
        arm: str,
        camera: str,
        fixture: Fixture,
        rng: np.random.Generator,
        flaws: SensorFlaws | None = None,
    ):
        station, self._arm = session.station, arm
        seen_by = station.cameras[camera]
        if not isinstance(seen_by.model, Intrinsics):
            raise TrocarError(
                f"camera {camera!r} of station {station.name!r} has no depth; spheres need an RGBD camera"
            )
        self.fixture = printed(fixture, rng)
        self._world = World(
            CellModel(
                {arm: session.models[arm]}, {arm: session.T_world_base[arm]}, EmptyTable(), worn={arm: self.fixture}
            )
        )
        self._camera = RayCamera(
            self._world.model,
            seen_by.model,
            session.T_world_camera[camera],
            seen_by.lamp_m,
            seen_by.flaws if flaws is None else flaws,
            Light(gain=seen_by.gain),
        )
        mujoco.mj_kinematics(self._world.model, self._world.data)

    def image(
        self,
        q_joint: NDArray[np.float64],
        corner_px: tuple[int, int],
        size_px: tuple[int, int],
        rng: np.random.Generator,
    ) -> RgbdImage:
        """Return a rectangle of the image of the arm at rest at these true joints (6,), jaws closed on the fixture."""
        data, index = self._world.data, self._world.arms[self._arm]
        data.qpos[index.qpos] = q_joint
        mujoco.mj_kinematics(self._world.model, data)
        return self._camera.cropped(data, corner_px, size_px).render(data, rng)
