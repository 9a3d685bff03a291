"""What simulated and real collections share: commands in view, the spheres' centres and their file, the joints."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from trocar.arms import ArmModel
from trocar.calibration.excitation import MotionBox
from trocar.calibration.recording import Recording
from trocar.collect.motion import View, commands_in_view
from trocar.errors import BadFile, InvalidInput
from trocar.files.archive import Archive, read_archive
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.perception.fiducial_joints import Measured, measure, require_psm
from trocar.perception.fiducials import SIX_SPHERES
from trocar.perception.image import Intrinsics, Window

MIN_ROWS = 30
FORMAT, VERSION = "trocar sphere centres", 2
Listener = Callable[[int, int], None]  # called with the number of rows done and of all rows


class CollectionPlan:
    """The commands of one arm that wears the spheres, and its joints measured from the spheres' centres.

    Attributes:
        arm: the arm's name.
        T_world_camera: registered pose of the camera.
        view: the camera's view, as registered.
        fixture: the spheres, as designed.
        q_cmd: (n, 6) commands; the first ``unseen`` take up the slack and get no image.
        t_s: (n,) time of each row on the robot; NaN while it is unknown.
    """

    def __init__(
        self,
        arm: str,
        model: ArmModel,
        lens: Intrinsics,
        T_world_camera: SE3,
        T_world_base: SE3,
        box: MotionBox,
        rows: int,
        *,
        motion: np.random.SeedSequence,
        search: np.random.SeedSequence,
        wide: bool = False,
    ):
        """Choose the commands.

        Args:
            arm: the arm's name.
            model: the arm's model.
            lens: the camera's lens.
            T_world_camera: registered pose of the camera.
            T_world_base: registered pose of the base.
            box: range of the motion.
            rows: number of samples.
            motion: seeds of the motion.
            search: seeds of the search for outliers.
            wide: whether the motion is the short one of wide swings.
        """
        if rows < MIN_ROWS:
            raise InvalidInput("a collection", f"of {rows} rows is too small to fit on", f"give {MIN_ROWS} or more")
        require_psm(model)
        self.arm, self.T_world_camera, self.fixture, self._search = arm, T_world_camera, SIX_SPHERES, search
        self.view = View(model, lens, T_world_camera.inverse() @ T_world_base)
        self.q_cmd = commands_in_view(self.view, box, rows, motion, wide=wide)
        self.unseen = len(self.q_cmd) - rows
        self.t_s = np.full(len(self.q_cmd), np.nan)

    @property
    def digest(self) -> str:
        """Return a hash that distinguishes this collection from others."""
        parts = (self.q_cmd, self.fixture.centers_m, self.view.T_camera_base.matrix)
        text = f"{self.arm} {self.view.lens}".encode()
        return hashlib.sha256(b"".join(part.tobytes() for part in parts) + text).hexdigest()[:16]

    @property
    def unknown(self) -> Array:
        """Return the centres (k, 3) of a row without an image: NaN."""
        return np.full((len(self.fixture.spheres), 3), np.nan)

    def window(self, row: int) -> Window:
        """Return the rectangle of pixels that the camera reads out for a row."""
        lower, upper = self.view.bounds_px(self.q_cmd[row])
        whole = np.array([self.view.lens.width, self.view.lens.height])
        first = np.clip(np.floor(lower), 0, whole - 2).astype(int)
        size = np.clip(np.ceil(upper), first + 2, whole).astype(int) - first
        return Window((int(first[0]), int(first[1])), (int(size[0]), int(size[1])))

    def kept(self, path: str | Path) -> list[Array]:
        """Return the centres (k, 3) of each row in a file, and take over their times; empty if there is no file.

        Raises BadFile: the file is of another collection, or damaged.
        """
        if not Path(path).is_file():
            return []
        archive = read_archive(path, FORMAT, VERSION)
        if archive.header.get("collection") != self.digest:
            raise BadFile(path, "is of another collection", "move it away, or choose another folder")
        nothing = np.zeros(0)
        centers, t_s = (archive.arrays.get(name, nothing) for name in ("p_camera_m", "t_s"))
        rows = len(centers)
        if centers.shape[1:] != self.unknown.shape or t_s.shape != (rows,) or rows > len(self.q_cmd):
            problem = f"is damaged: its centres have shape {centers.shape}, its times {t_s.shape}"
            raise BadFile(path, problem, "move it away, or choose another folder")
        self.t_s[:rows] = t_s
        return list(np.asarray(centers, dtype=np.float64))

    def keep(self, centers: list[Array], path: str | Path) -> None:
        """Write the centres of the rows so far, and their times."""
        header = {"format": FORMAT, "version": VERSION, "arm": self.arm, "collection": self.digest}
        Archive(header, {"p_camera_m": np.array(centers), "t_s": self.t_s[: len(centers)]}).save(path)

    def measured(self, p_camera_m: Array) -> Measured:
        """Return the base, and the joints for the base as registered, from the centres (n, k, 3) of all rows."""
        rng, view = np.random.default_rng(self._search), self.view
        return measure(view.arm, self.fixture, p_camera_m, self.q_cmd, view.T_camera_base, rng)

    def recording(self, measured: Measured) -> Recording:
        """Return the recording to which cable models are fitted."""
        return Recording(
            q_cmd=self.q_cmd,
            q_phy=measured.q,
            valid=measured.valid & np.isfinite(measured.q).all(axis=1),
            t_s=self.t_s,
            name=f"images of {self.arm}",
        )
