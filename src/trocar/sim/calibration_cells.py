"""Calibration in simulation: images of spheres on an arm and of a checkerboard, and recordings with drawn noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from trocar.arms import fk
from trocar.calibration.excitation import WIDE_ROWS, MotionBox, random_smooth_path, slack_taken_up, wide_path
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3, shown
from trocar.geometry.arrays import Array
from trocar.lab import SensorFlaws, Station
from trocar.lab.session import Session
from trocar.lab.transmission import DriveTrain
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project, rays_through
from trocar.perception.fiducial_joints import joints_of_tips
from trocar.perception.fiducials import Fixture
from trocar.perception.image import Intrinsics, RgbdImage, StereoImage, StereoRig, Window
from trocar.sim.cameras import CameraRenderer
from trocar.sim.spec import INTANGIBLE, SOLID, digits
from trocar.sim.world import TaskWorld, World

EMPTY_TABLE_RGB = (0.05, 0.05, 0.05)
TABLE_BELOW_M = 0.08
"""The black table, cleared for the calibration, lies this much below the world's origin (assumed)."""

WHITE_RGB, BLACK_RGB = (0.39, 0.39, 0.39), (0.03, 0.03, 0.03)
"""Colours of a matte print that does not mirror the lamp (assumed)."""
TABLE_RGB = (0.2, 0.2, 0.2)
THICK_M, PRINT_M = 2e-3, 2e-6
"""Thickness of the board, and height of its black squares, which is too small to move an edge visibly."""
TURN_RAD = (0.6, 0.6, 0.8)
DISTANCES = (0.8, 1.1)
"""How a person holds the board: greatest rotation about the camera's axes, and least and greatest distance as a share
of the workspace's distance (assumed)."""
TRIES = 10_000

SAMPLE_S = 0.8
"""Time between two samples of a calibration recording (paper: 1355 in 18 minutes)."""


class EmptyTable(TaskWorld):
    """A black table with nothing on it, far below the world's origin."""

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add the table."""
        _add_table(spec, -TABLE_BELOW_M, EMPTY_TABLE_RGB, INTANGIBLE)


def _add_table(spec: mujoco.MjSpec, z_m: float, rgb: tuple[float, float, float], collisions: Mapping[str, int]) -> None:
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (2, 2, 0.01), "pos": (0, 0, z_m), "rgba": (*rgb, 1)}
    spec.worldbody.add_geom(name="table", **plane, **collisions)


def printed(fixture: Fixture, rng: np.random.Generator) -> Fixture:
    """Return a fixture as printed, with each sphere slightly off its designed position."""
    centers = fixture.centers_m + fixture.print_sd_m * rng.standard_normal((len(fixture.spheres), 3))
    moved = zip(fixture.spheres, centers.tolist(), strict=True)
    return replace(fixture, spheres=tuple(replace(sphere, center_m=tuple(center)) for sphere, center in moved))


class FiducialCell:
    """Takes images of an arm at rest that carries painted spheres. Simulator truth; estimators get only its images.

    Args:
        session: the session; its true base and camera are used.
        arm: the arm's name.
        camera: the camera's name.
        fixture: the spheres that the arm carries, as designed.
        rng: random numbers for the printing errors.
        flaws: override those of the station's camera.

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
            what = f"camera {camera!r} of station {session.station.name!r}"
            raise InvalidInput(what, "has no depth", "spheres need an RGBD camera")
        self.fixture = printed(fixture, rng)
        models, bases = {arm: session.models[arm]}, {arm: session.T_world_base[arm]}
        self._world = World(models, bases, EmptyTable(), fixtures={arm: self.fixture})
        self._joints = self._world.arms[arm].qpos
        self._camera = CameraRenderer(self._world.model, seen_by, session.T_world_camera[camera], flaws)
        mujoco.mj_kinematics(self._world.model, self._world.data)

    def image(self, q_joint: Array, window: Window, rng: np.random.Generator) -> RgbdImage:
        """Return a window of the arm's image at rest at these true joints (6,), jaws closed on the fixture."""
        data = self._world.data
        data.qpos[self._joints] = q_joint
        mujoco.mj_kinematics(self._world.model, data)
        image = self._camera.image(data, rng, window)
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
    """Takes images of a checkerboard. Simulator truth; estimators get only its images.

    Args:
        station: the station; the true lenses and pose of its camera are used.
        camera: the camera's name.
        board: the board shown, with a white rim as wide as a square.
        table_z_m: height of the table in the world.

    Raises:
        InvalidInput: the camera is not a stereo pair.
    """

    def __init__(self, station: Station, camera: str, board: Checkerboard, table_z_m: float):
        seen_by = replace(station.cameras[camera], rig_registered=None)
        if not isinstance(seen_by.model, StereoRig):
            what = f"camera {camera!r} of station {station.name!r}"
            raise InvalidInput(what, "is not a stereo pair, which a checkerboard needs", "name another camera")
        self._rig, self._T_world_camera = seen_by.model, seen_by.T_world_camera
        self._board, self._table_z_m = board, table_z_m
        self._world = World({}, {}, _CheckerboardWorld(board, table_z_m))
        self._camera = CameraRenderer(self._world.model, seen_by, seen_by.T_world_camera)

    def hand_pose(self, rng: np.random.Generator, distance_m: float) -> SE3:
        """Return a random pose in the world of a board held by hand, which both lenses see whole.

        Args:
            rng: random numbers for position and rotation.
            distance_m: distance of the workspace from the lenses.

        Raises:
            InvalidInput: the board is too large to be seen whole.
        """
        (width, height), rim = self._board.size_m, self._board.square_m
        corners = np.array([[x * (width / 2 + rim), y * (height / 2 + rim), 0.0] for x in (-1, 1) for y in (-1, 1)])
        rig, T_right_left = self._rig, self._rig.T_left_right.inverse()
        for _ in range(TRIES):
            depth = distance_m * rng.uniform(*DISTANCES)
            pixel = rng.uniform((0.0, 0.0), (rig.left.width, rig.left.height))
            turn = SO3.exp(rng.uniform(-1.0, 1.0, 3) * TURN_RAD)
            T_left_board = SE3.from_parts(turn, depth * rays_through(rig.left, pixel))
            p_left = T_left_board.apply(corners)
            in_view = _inside(rig.left, p_left) and _inside(rig.right, T_right_left.apply(p_left))
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


def _inside(lens: Intrinsics, p_lens: Array) -> bool:
    pixels = project(lens, p_lens)
    return bool(((pixels >= 0) & (pixels <= (lens.width - 1, lens.height - 1))).all())


def record_motion(
    session: Session,
    arm: str,
    rng: np.random.Generator,
    box: MotionBox,
    samples: int | None = None,
    *,
    wide: bool = False,
) -> Recording:
    """Return a calibration recording of this arm: the paper's random smooth motion, seen by noisy fiducials.

    The joints are those of the cell's drive train at rest after each step of .8 s; the servos' error at rest, below a
    thousandth of the cables', is left out (tested). Images of the fiducials are not simulated; the measurements have
    the noise of the recordings. Before the first sample the wrist swings back and forth to take up the slack; these
    rows are commands without a measurement.

    Args:
        session: the session with the arm's transmission.
        arm: the arm's name.
        rng: random numbers for motion and noise.
        box: range of the motion.
        samples: number of samples; None: the default of either motion.
        wide: whether the motion is the short one of wide swings.
    """
    model = session.station.arm(arm).model
    path = wide_path(model, samples or WIDE_ROWS, box) if wide else random_smooth_path(model, rng, box=box)[:samples]
    q_cmd = slack_taken_up(model, path)
    train, joints = DriveTrain(session.transmissions[arm], q_cmd[0], rng), []
    for q in q_cmd:
        train.advance(SAMPLE_S)
        joints.append(train.joints(q))
    # Fiducials are measured relative to the registered base: the measured joints put the tip where it is if the base is
    # there. So errors of registration are in the recording and in its model.
    T_found_true = session.T_world_base_registered[arm].inverse() @ session.T_world_base[arm]
    q_true = np.array(joints)
    tips = T_found_true @ fk(session.models[arm], q_true)
    measured = joints_of_tips(model, tips, q_true)
    measured = measured + session.transmissions[arm].measurement_sd * rng.standard_normal(q_cmd.shape)
    return Recording(
        q_cmd=q_cmd,
        q_phy=measured,
        valid=(np.arange(len(q_cmd)) >= len(q_cmd) - len(path)) & np.isfinite(measured).all(axis=1),
        t_s=SAMPLE_S * np.arange(1.0, len(q_cmd) + 1.0),
        name=f"simulated recording of {arm}",
    )
