"""A collection: commands, images of an arm at rest after each, spheres found in them, joints from these."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from trocar.calibration.excitation import SAMPLES, MotionBox
from trocar.calibration.recording import Recording
from trocar.collect.motion import View, commands_in_view, depth_camera
from trocar.errors import BadFile, InvalidInput
from trocar.files.archive import Archive, read_archive
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.lab import SensorFlaws
from trocar.lab.session import Session
from trocar.lab.transmission import DriveTrain
from trocar.perception.fiducial_joints import Measured, measure, require_psm
from trocar.perception.fiducials import SIX_SPHERES
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.perception.spheres import find_spheres
from trocar.sim.calibration_cells import FiducialCell

SAMPLE_S = 0.75
"""Time of one sample: a move of .1 rad, settling, an exposure of .15 s (recordings: .4 to 1.1 s; the paper: .8 s)."""
SAVED_EVERY = 25  # results are saved after this many rows
MIN_ROWS = 30
FORMAT, VERSION = "trocar sphere centres", 1
Listener = Callable[[int, int], None]  # called with the number of rows done and of all rows


class Collection:
    """The calibration of one arm by the spheres that it wears, in the simulated cell.

    Commands and estimates see the registered poses, the encoders and the images; the truth stays inside.

    Attributes:
        q_cmd: (n, 6) commands; the first two take up the slack and get no image.
        view: of the camera, as registered.
    """

    def __init__(
        self,
        session: Session,
        arm: str,
        box: MotionBox,
        seeds: np.random.SeedSequence,
        rows: int = SAMPLES,
        *,
        wide: bool = False,
        flaws: SensorFlaws | None = None,
    ):
        """Choose the commands; no image is taken yet.

        Args:
            session: with the cables and the camera.
            arm: which one, by name.
            box: range of the motion.
            seeds: of everything random.
            rows: how many samples.
            wide: whether the motion is the short one of wide swings.
            flaws: of the camera, in place of the station's.
        """
        if rows < MIN_ROWS:
            raise InvalidInput("a collection", f"of {rows} rows is too small to fit on", f"give {MIN_ROWS} or more")
        station = session.station
        self._session, self.arm, self.fixture, self._flaws = session, arm, SIX_SPHERES, flaws
        self.model = station.arm(arm).model
        require_psm(self.model)
        self._camera = depth_camera(station)
        lens = station.cameras[self._camera].model
        assert isinstance(lens, Intrinsics)
        T_camera_world = session.T_world_camera_registered[self._camera].inverse()
        self.view = View(self.model, lens, T_camera_world @ session.T_world_base_registered[arm])
        motion, cables, self._printer, self._images, self._search = seeds.spawn(5)
        self.q_cmd = commands_in_view(self.view, box, rows, motion, wide=wide)
        self._unseen = len(self.q_cmd) - rows
        train, rested = DriveTrain(session.transmissions[arm], self.q_cmd[0], np.random.default_rng(cables)), []
        for q in self.q_cmd:
            train.advance(SAMPLE_S)
            rested.append(train.joints(q))
        self._q_joint = np.array(rested)
        self._row_seeds = self._images.spawn(len(self.q_cmd))
        self._cell: FiducialCell | None = None

    @property
    def duration_s(self) -> float:
        """Return the time that it takes on the robot."""
        return SAMPLE_S * len(self.q_cmd)

    @property
    def q_joint(self) -> Array:
        """Return the true joints (n, 6): for evaluating the estimate, never for the estimate itself."""
        return self._q_joint.copy()

    @property
    def T_world_camera_registered(self) -> SE3:
        """Return the camera's pose as registered."""
        return self._session.T_world_camera_registered[self._camera]

    @property
    def T_camera_base_true(self) -> SE3:
        """Return the true pose of the base in the camera, only for evaluating the registration."""
        return self._session.T_world_camera[self._camera].inverse() @ self._session.T_world_base[self.arm]

    @property
    def digest(self) -> str:
        """Return what distinguishes this collection from others."""
        parts = (self.q_cmd, self._q_joint, self.fixture.centers_m, self.view.T_camera_base.matrix)
        text = f"{self.arm} {self._printer} {self._images} {self.view.lens} {self._flaws}".encode()
        return hashlib.sha256(b"".join(part.tobytes() for part in parts) + text).hexdigest()[:16]

    def image(self, row: int) -> RgbdImage:
        """Return the image taken after this row's command: the rectangle of pixels round the instrument."""
        if self._cell is None:
            rng = np.random.default_rng(self._printer)
            self._cell = FiducialCell(self._session, self.arm, self._camera, self.fixture, rng, self._flaws)
        corner, size = self._window(row)
        return self._cell.image(self._q_joint[row], corner, size, np.random.default_rng(self._row_seeds[row]))

    def look(self, row: int) -> Array:
        """Return the spheres' centres (k, 3) in the camera frame after this row's command, as found in its image."""
        return find_spheres(self.image(row), self.fixture)

    def _window(self, row: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return corner and size of the rectangle of pixels that is read out for a row."""
        lower, upper = self.view.bounds_px(self.q_cmd[row])
        whole = np.array([self.view.lens.width, self.view.lens.height])
        first = np.clip(np.floor(lower), 0, whole - 2).astype(int)
        size = np.clip(np.ceil(upper), first + 2, whole).astype(int) - first
        return (int(first[0]), int(first[1])), (int(size[0]), int(size[1]))

    def run(self, path: str | Path | None = None, listener: Listener | None = None) -> Array:
        """Return the centres (n, k, 3) of all rows; resume where the file of an interrupted collection ends.

        ``path``: of the file; None: nothing is kept; ``listener``: called after each row.

        Raises TrocarError: the file is of another collection, damaged, or cannot be written.
        """
        path = None if path is None else Path(path)
        found = [] if path is None else list(self._kept(path))
        for row in range(len(found), len(self.q_cmd)):
            found.append(self.look(row) if row >= self._unseen else np.full((len(self.fixture.spheres), 3), np.nan))
            if path is not None and (row + 1 == len(self.q_cmd) or row % SAVED_EVERY == 0):
                self._keep(np.array(found), path)
            if listener is not None:
                listener(row + 1, len(self.q_cmd))
        return np.array(found)

    def _kept(self, path: Path) -> Array:
        nothing = np.zeros((0, len(self.fixture.spheres), 3))
        if not path.is_file():
            return nothing
        archive = read_archive(path, FORMAT, VERSION)
        centers = archive.arrays.get("p_camera_m", nothing)
        if archive.header.get("collection") != self.digest:
            raise BadFile(path, "is of another collection", "move it away, or choose another folder")
        if centers.shape[1:] != nothing.shape[1:] or len(centers) > len(self.q_cmd):
            problem = f"is damaged: its centres have shape {centers.shape}"
            raise BadFile(path, problem, "move it away, or choose another folder")
        return np.asarray(centers, dtype=np.float64)

    def _keep(self, centers: Array, path: Path) -> None:
        header = {"format": FORMAT, "version": VERSION, "arm": self.arm, "collection": self.digest}
        Archive(header, {"p_camera_m": centers}).save(path)

    def measured(self, p_camera_m: Array) -> Measured:
        """Return base and joints from the centres of all rows."""
        return measure(self.model, self.fixture, p_camera_m, self.q_cmd, np.random.default_rng(self._search))

    def recording(self, measured: Measured) -> Recording:
        """Return the recording that cable models are fitted on."""
        return Recording(
            q_cmd=self.q_cmd,
            q_phy=measured.q,
            valid=measured.valid & np.isfinite(measured.q).all(axis=1),
            t_s=SAMPLE_S * np.arange(1.0, len(self.q_cmd) + 1.0),
            name=f"images of {self.arm}",
        )
