"""A collection in simulation: images of an arm at rest after each command, and the truth to evaluate estimates."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from trocar.arms import fk
from trocar.calibration.excitation import SAMPLES, MotionBox
from trocar.collect.motion import depth_camera
from trocar.collect.plan import CollectionPlan, Listener
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.lab import SensorFlaws
from trocar.lab.session import Session
from trocar.lab.transmission import DriveTrain
from trocar.perception.fiducial_joints import joints_of_tips
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.perception.spheres import find_spheres
from trocar.sim.calibration_cells import FiducialCell

SAMPLE_S = 0.75
"""Time of one sample: a move of .1 rad, settling, an exposure of .15 s (recordings: .4 to 1.1 s; the paper: .8 s)."""
SAVED_EVERY = 25  # results are saved after this many rows


class Collection(CollectionPlan):
    """The calibration of one arm by the spheres that it wears, in the simulated cell.

    Commands and estimates see the registered poses, the encoders and the images; the truth stays inside.
    """

    def __init__(
        self,
        session: Session,
        arm: str,
        box: MotionBox,
        seeds: np.random.SeedSequence,
        rows: int = SAMPLES,
        *,
        every: int = 1,
        wide: bool = False,
        flaws: SensorFlaws | None = None,
    ):
        """Choose the commands; no image is taken yet.

        Args:
            session: the day whose cables and camera are used.
            arm: the arm's name.
            box: range of the motion.
            seeds: seeds of all random numbers.
            rows: number of samples.
            every: number of samples per image.
            wide: whether the motion is the short one of wide swings.
            flaws: override those of the station's camera.
        """
        station = session.station
        self._session, self._flaws, self._every = session, flaws, every
        self._camera = depth_camera(station)
        lens = station.cameras[self._camera].model
        assert isinstance(lens, Intrinsics)
        model, T_world_camera = station.arm(arm).model, session.T_world_camera_registered[self._camera]
        motion, cables, self._printer, self._images, search = seeds.spawn(5)
        base = session.T_world_base_registered[arm]
        super().__init__(arm, model, lens, T_world_camera, base, box, rows, motion=motion, search=search, wide=wide)
        self.t_s = SAMPLE_S * np.arange(1.0, len(self.q_cmd) + 1.0)
        train, rested = DriveTrain(session.transmissions[arm], self.q_cmd[0], np.random.default_rng(cables)), []
        for q in self.q_cmd:
            train.advance(SAMPLE_S)
            rested.append(train.joints(q))
        self._q_joint = np.array(rested)
        self._row_seeds = self._images.spawn(len(self.q_cmd))
        self._cell: FiducialCell | None = None

    @property
    def q_joint(self) -> Array:
        """Return the joints (n, 6) that would put the tip where it truly is if the base were where it is registered.

        An estimate should find these. They serve to evaluate it, never to make it.
        """
        T_camera_tip = self.T_camera_base_true @ fk(self._session.models[self.arm], self._q_joint)
        return joints_of_tips(self.view.arm, self.view.T_camera_base.inverse() @ T_camera_tip, self._q_joint)

    @property
    def T_camera_base_true(self) -> SE3:
        """Return the true pose of the base in the camera, only to evaluate the registration."""
        return self._session.T_world_camera[self._camera].inverse() @ self._session.T_world_base[self.arm]

    @property
    def digest(self) -> str:
        """Return a hash that distinguishes this collection from others."""
        text = f"{super().digest} {self._printer} {self._images} {self._flaws} {self._every}".encode()
        return hashlib.sha256(self._q_joint.tobytes() + text).hexdigest()[:16]

    def image(self, row: int) -> RgbdImage:
        """Return the image taken after this row's command: the rectangle of pixels round the instrument."""
        if self._cell is None:
            rng = np.random.default_rng(self._printer)
            self._cell = FiducialCell(self._session, self.arm, self._camera, self.fixture, rng, self._flaws)
        return self._cell.image(self._q_joint[row], self.window(row), np.random.default_rng(self._row_seeds[row]))

    def look(self, row: int) -> Array:
        """Return the spheres' centres (k, 3) in the camera frame after this row's command, as found in its image."""
        return find_spheres(self.image(row), self.fixture)

    def run(self, path: str | Path | None = None, listener: Listener | None = None) -> Array:
        """Return the centres (n, k, 3) of all rows; resume where the file of an interrupted collection ends.

        Args:
            path: the file; None keeps nothing.
            listener: called after each row.

        Raises:
            TrocarError: the file is of another collection, damaged, or cannot be written.
        """
        path = None if path is None else Path(path)
        found = [] if path is None else self.kept(path)
        for row in range(len(found), len(self.q_cmd)):
            pictured = row >= self.unseen and (row - self.unseen) % self._every == 0
            found.append(self.look(row) if pictured else self.unknown)
            if path is not None and (row + 1 == len(self.q_cmd) or row % SAVED_EVERY == 0):
                self.keep(found, path)
            if listener is not None:
                listener(row + 1, len(self.q_cmd))
        return np.array(found)
