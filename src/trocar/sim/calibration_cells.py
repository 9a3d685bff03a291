"""The simulated cell during calibration: an arm that carries spheres, a checkerboard in view; the rest is withdrawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3, shown
from trocar.lab import SensorFlaws, Station
from trocar.lab.session import Session
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project, rays_through
from trocar.perception.fiducials import Fixture
from trocar.perception.image import Intrinsics, RgbdImage, StereoImage, StereoRig, Window
from trocar.sim.cameras import CameraRenderer
from trocar.sim.spec import INTANGIBLE, SOLID, digits
from trocar.sim.world import TaskWorld, World

EMPTY_TABLE_RGB = (0.05, 0.05, 0.05)
TABLE_BELOW_M = 0.08
"""The black table, cleared for the calibration, lies this much below the world's origin (assumed)."""

WHITE_RGB, BLACK_RGB = (0.39, 0.39, 0.39), (0.03, 0.03, 0.03)
"""Matte print, too dull to mirror the lamp (assumed)."""
TABLE_RGB = (0.2, 0.2, 0.2)
THICK_M, PRINT_M = 2e-3, 2e-6
"""Thickness of the board, and how far its black squares stand out: so little that no edge moves visibly."""
TURN_RAD = (0.6, 0.6, 0.8)
DISTANCES = (0.8, 1.1)
"""How a person holds the board: rotated about the camera's axes by up to this, and this far away as a share of the
workspace's distance (assumed)."""
TRIES = 10_000


class EmptyTable(TaskWorld):
    """A black table with nothing on it, far below the world's origin."""

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add it."""
        _add_table(spec, -TABLE_BELOW_M, EMPTY_TABLE_RGB, INTANGIBLE)


def _add_table(spec: mujoco.MjSpec, z_m: float, rgb: tuple[float, float, float], collisions: Mapping[str, int]) -> None:
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (2, 2, 0.01), "pos": (0, 0, z_m), "rgba": (*rgb, 1)}
    spec.worldbody.add_geom(name="table", **plane, **collisions)


def printed(fixture: Fixture, rng: np.random.Generator) -> Fixture:
    """Return a fixture as printed: each sphere slightly off its place."""
    off = fixture.print_sd_m * rng.standard_normal((len(fixture.spheres), 3))
    moved = [
        replace(sphere, center_m=tuple((np.array(sphere.center_m) + shift).tolist()))
        for sphere, shift in zip(fixture.spheres, off, strict=True)
    ]
    return replace(fixture, spheres=tuple(moved))


class FiducialCell:
    """Takes images of an arm at rest that carries painted spheres. Simulator truth; estimators get only its images.

    Args:
        session: the session; its true base and camera are used.
        arm: which arm.
        camera: which of the station's cameras.
        fixture: that the arm carries, as designed; its printing errors are drawn.
        rng: draws the printing errors.
        flaws: of the camera, in place of the station's.

    Raises:
        InvalidInput: the camera has no depth.
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
        seen_by = session.station.cameras[camera]
        if not isinstance(seen_by.model, Intrinsics):
            raise InvalidInput(
                f"camera {camera!r} of station {session.station.name!r}", "has no depth", "spheres need an RGBD camera"
            )
        self.fixture = printed(fixture, rng)
        models, bases = {arm: session.models[arm]}, {arm: session.T_world_base[arm]}
        self._world = World(models, bases, EmptyTable(), fixtures={arm: self.fixture})
        self._joints = self._world.arms[arm].qpos
        self._camera = CameraRenderer(self._world.model, seen_by, session.T_world_camera[camera], flaws)
        mujoco.mj_kinematics(self._world.model, self._world.data)

    def image(
        self,
        q_joint: NDArray[np.float64],
        corner_px: tuple[int, int],
        size_px: tuple[int, int],
        rng: np.random.Generator,
    ) -> RgbdImage:
        """Return a rectangle of the image of the arm at rest at these true joints (6,), jaws closed on the fixture."""
        data = self._world.data
        data.qpos[self._joints] = q_joint
        mujoco.mj_kinematics(self._world.model, data)
        image = self._camera.image(data, rng, Window(corner_px, size_px))
        assert isinstance(image, RgbdImage)  # __init__ has checked the camera
        return image


class _CheckerboardWorld(TaskWorld):
    """The board as a free body, over a table."""

    def __init__(self, board: Checkerboard, table_z_m: float):
        self._board, self._table_z_m = board, table_z_m

    def add(self, spec: mujoco.MjSpec) -> None:
        board = self._board
        _add_table(spec, self._table_z_m, TABLE_RGB, {})
        body = spec.worldbody.add_body(name="checkerboard")
        body.add_freejoint()

        def add_box(size_m: ArrayLike, middle_m: ArrayLike, rgb: tuple[float, float, float]) -> None:
            box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": digits(size_m), "pos": digits(middle_m)}
            body.add_geom(rgba=(*rgb, 1), **box, **SOLID)

        half = 0.5 * (np.array(board.size_m) + 2 * board.square_m)
        add_box((*half, THICK_M / 2), (0.0, 0.0, PRINT_M + THICK_M / 2), WHITE_RGB)
        middles, black = board.squares_m
        for x, y, _ in middles[black]:
            add_box((board.square_m / 2, board.square_m / 2, PRINT_M / 2), (x, y, PRINT_M / 2), BLACK_RGB)


class CheckerboardCell:
    """Takes images of a checkerboard. Simulator truth; estimators get its images alone.

    Args:
        station: whose camera looks; its true lenses and pose are used.
        camera: which of the station's cameras.
        board: the one shown, with a white rim as wide as a square.
        table_z_m: height of the table in the world.
        flaws: of the camera, in place of the station's.

    Raises:
        InvalidInput: the camera is not a stereo pair.
    """

    def __init__(
        self, station: Station, camera: str, board: Checkerboard, table_z_m: float, flaws: SensorFlaws | None = None
    ):
        seen_by = replace(station.cameras[camera], rig_registered=None)
        if not isinstance(seen_by.model, StereoRig):
            raise InvalidInput(
                f"camera {camera!r} of station {station.name!r}",
                "is not a stereo pair, which a checkerboard needs",
                "name another camera",
            )
        self._rig, self._T_world_camera = seen_by.model, seen_by.T_world_camera
        self._board, self._table_z_m = board, table_z_m
        self._world = World({}, {}, _CheckerboardWorld(board, table_z_m))
        self._camera = CameraRenderer(self._world.model, seen_by, seen_by.T_world_camera, flaws)

    def hand_pose(self, rng: np.random.Generator, distance_m: float) -> SE3:
        """Return a pose in the world in which a person holds the board, so that both lenses see the whole of it.

        Args:
            rng: draws place, tilt and turn.
            distance_m: of the workspace from the lenses.

        Raises:
            InvalidInput: the board is too large for it.
        """
        width, height = self._board.size_m
        rim = self._board.square_m
        corners = np.array([[x * (width / 2 + rim), y * (height / 2 + rim), 0.0] for x in (-1, 1) for y in (-1, 1)])
        rig, T_right_left = self._rig, self._rig.T_left_right.inverse()
        for _ in range(TRIES):
            depth = distance_m * rng.uniform(*DISTANCES)
            pixel = rng.uniform((0.0, 0.0), (rig.left.width, rig.left.height))
            turn = SO3.exp(rng.uniform(-1.0, 1.0, 3) * TURN_RAD)
            T_left_board = SE3.from_parts(turn, depth * rays_through(rig.left, pixel))
            p_left = T_left_board.apply(corners)
            in_view = all(
                _inside(lens, project(lens, p))
                for lens, p in ((rig.left, p_left), (rig.right, T_right_left.apply(p_left)))
            )
            T_world_board = self._T_world_camera @ T_left_board
            if in_view and T_world_board.apply(corners)[:, 2].min() > self._table_z_m + THICK_M:
                return T_world_board
        raise InvalidInput(
            f"a checkerboard of {1e3 * width:.0f} x {1e3 * height:.0f} mm",
            f"is not seen whole by both lenses at {shown(distance_m, 'm', '.0f')}",
            "give a smaller 'square_mm'",
        )

    def image(self, T_world_board: SE3, rng: np.random.Generator) -> StereoImage:
        """Return the images of the board at this pose in both lenses."""
        data = self._world.data
        data.qpos[:3] = T_world_board.translation_m
        data.qpos[3:7] = T_world_board.rotation.as_quaternion()
        mujoco.mj_kinematics(self._world.model, data)
        image = self._camera.image(data, rng)
        assert isinstance(image, StereoImage)  # __init__ has checked the camera
        return image


def _inside(lens: Intrinsics, pixels: NDArray[np.float64]) -> bool:
    return bool(((pixels >= 0) & (pixels <= (lens.width - 1, lens.height - 1))).all())
