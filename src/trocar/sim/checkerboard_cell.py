"""A checkerboard in view of the simulated cell's stereo camera, held by hand or bracket; the arms are withdrawn."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, Station
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project, rays_through
from trocar.perception.image import Intrinsics, StereoImage, StereoRig
from trocar.sim.elements import add, scene_bits, text
from trocar.sim.mjcf import CellModel
from trocar.sim.station_cameras import EYE_GAINS, eyes_of
from trocar.sim.task_world import TaskWorld
from trocar.sim.world import World

WHITE_RGB, BLACK_RGB = (0.39, 0.39, 0.39), (0.03, 0.03, 0.03)
"""Matte print, too dull to mirror the lamp (assumed)."""
TABLE_RGB = (0.2, 0.2, 0.2)
THICK_M, PRINT_M = 2e-3, 2e-6
"""Thickness of the board, and how far its black squares stand out: so little that no edge moves visibly."""
BODY = "checkerboard"
TURN_RAD = (0.6, 0.6, 0.8)
DISTANCES = (0.8, 1.1)
"""How a person holds the board: rotated about the camera's axes by up to this, and this far away as a share of the
workspace's distance (assumed)."""
TRIES = 10_000


class _Held(TaskWorld):
    """The board as a free body, over a table."""

    def __init__(self, board: Checkerboard, table_z_m: float):
        self._board, self._table_z_m = board, table_z_m

    def add(self, world: Element, assets: Element) -> None:
        board, bits = self._board, scene_bits()
        table = (0.0, 0.0, self._table_z_m)
        add(world, "geom", name="table", type="plane", size="2 2 0.01", pos=text(table), rgba=text((*TABLE_RGB, 1)))
        body = add(world, "body", name=BODY)
        add(body, "freejoint")
        half = 0.5 * (np.array(board.size_m) + 2 * board.square_m)
        add(
            body,
            "geom",
            type="box",
            size=text((*half, THICK_M / 2)),
            pos=text((0.0, 0.0, PRINT_M + THICK_M / 2)),
            rgba=text((*WHITE_RGB, 1)),
            **bits,
        )
        middles, black = board.squares_m
        for x, y, _ in middles[black]:
            add(
                body,
                "geom",
                type="box",
                size=text((board.square_m / 2, board.square_m / 2, PRINT_M / 2)),
                pos=text((x, y, PRINT_M / 2)),
                rgba=text((*BLACK_RGB, 1)),
                **bits,
            )


class CheckerboardCell:
    """Takes images of a checkerboard. Simulator truth; estimators get its images alone.

    Args:
        station: whose camera looks; its true lenses and pose are used.
        camera: which of the station's cameras.
        board: the one shown, with a white rim as wide as a square.
        table_z_m: height of the table in the world.
        flaws: of the camera, in place of the station's.
    """

    def __init__(
        self, station: Station, camera: str, board: Checkerboard, table_z_m: float, flaws: SensorFlaws | None = None
    ):
        seen_by = station.cameras[camera]
        if not isinstance(seen_by.model, StereoRig):
            raise TrocarError(
                f"camera {camera!r} of station {station.name!r} is not a stereo pair, which a checkerboard needs; "
                "name another camera"
            )
        self._rig, self._T_world_camera = seen_by.model, seen_by.T_world_camera
        self._board, self._table_z_m = board, table_z_m
        self._world = World(CellModel({}, {}, _Held(board, table_z_m)))
        self._eyes = eyes_of(self._world.model, seen_by, seen_by.T_world_camera, flaws)

    def hand_pose(self, rng: np.random.Generator, distance_m: float) -> SE3:
        """Return a pose in the world in which a person holds the board, so that both eyes see the whole of it.

        Args:
            rng: draws place, tilt and turn.
            distance_m: of the workspace from the eyes.

        Raises:
            TrocarError: the board is too large for it.
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
        raise TrocarError(
            f"a checkerboard of {1e3 * width:.0f} x {1e3 * height:.0f} mm is not seen whole by both eyes at "
            f"{1e3 * distance_m:.0f} mm; give a smaller 'square_mm'"
        )

    def image(self, T_world_board: SE3, rng: np.random.Generator) -> StereoImage:
        """Return the images of the board at this pose in both eyes."""
        data = self._world.data
        data.qpos[:3] = T_world_board.translation_m
        data.qpos[3:7] = T_world_board.rotation.as_quaternion()
        mujoco.mj_kinematics(self._world.model, data)
        left, right = (eye.render_color(data, rng, gain) for eye, gain in zip(self._eyes, EYE_GAINS, strict=True))
        return StereoImage(left, right, self._rig)


def _inside(lens: Intrinsics, pixels: NDArray[np.float64]) -> bool:
    return bool(((pixels >= 0) & (pixels <= (lens.width - 1, lens.height - 1))).all())
