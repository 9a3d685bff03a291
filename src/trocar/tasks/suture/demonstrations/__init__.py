"""Recorded sutures, and the manipulability of the arms in them, which is part of the reward (paper, IV-A2).

A set of demonstrations is a folder with a ``demonstrations.toml`` and recordings (``recordings``): tables of joint
states (.csv) or JIGSAWS texts (.txt). ``docs/demonstrations.md`` shows one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, manipulability
from trocar.errors import BadFile, InvalidInput
from trocar.geometry import SE3, TURN

NAME = "demonstrations.toml"
SAME_PLACE_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Mean squared manipulability of each arm at places round the circle, from recorded sutures.

    At a place it is the mean over the recordings there, each with equal weight whatever its length; between places it
    is interpolated linearly from the two neighbours, round the circle (paper, IV-A2).

    Attributes:
        places_rad: (p,) ascending, in [0, 2 pi), counterclockwise from x of the circle.
        per_arm: (arms, p) mean of ``|J J^T|`` over a recording's rows, in m^4.
        source: origin of the recordings, and what was assumed in reading them, in words.
        sd: (p,) standard deviation, over the recordings at a place, of the mean over the arms; 0 where there is one.
    """

    places_rad: NDArray[np.float64]
    per_arm: NDArray[np.float64]
    source: str
    sd: NDArray[np.float64]

    def sd_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return the standard deviation (n,) over recordings at any angles (n,)."""
        return np.interp(np.asarray(thetas_rad, dtype=np.float64), self.places_rad, self.sd, period=TURN)

    def per_arm_at(self, thetas_rad: ArrayLike) -> NDArray[np.float64]:
        """Return each arm's manipulability (arms, n) at any angles (n,); their mean is M (paper, Fig. 6)."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        return np.stack([np.interp(thetas, self.places_rad, row, period=TURN) for row in self.per_arm])


def demonstrations_from_joints(
    thetas_rad: ArrayLike, joints: Sequence[NDArray[np.float64]], arms: Sequence[ArmModel], source: str
) -> Demonstrations:
    """Return the demonstrations computed from recorded joint states.

    Args:
        thetas_rad: (r,) position of each recorded suture; recordings at the same place are averaged.
        joints: r recordings (n, arms, 6), rad and m.
        arms: the recorded arms.
        source: origin of the recordings, in words.

    Raises:
        InvalidInput: there are fewer than two places.
    """
    thetas = np.mod(np.asarray(thetas_rad, dtype=np.float64), TURN)
    thetas[TURN - thetas < SAME_PLACE_RAD] = 0.0
    squares = np.array([[(manipulability(arm, q[:, a]) ** 2).mean() for a, arm in enumerate(arms)] for q in joints])
    order = np.argsort(thetas, kind="stable")
    place = np.cumsum(np.diff(thetas[order], prepend=-1.0) > SAME_PLACE_RAD) - 1
    if len(place) == 0 or place[-1] == 0:
        raise InvalidInput(
            "the demonstrations",
            f"cover {len(set(place.tolist()))} place(s) of the circle",
            "record sutures at two or more, so that manipulability can be interpolated between them (the paper: eight)",
        )
    per_arm = np.stack([np.bincount(place, column) / np.bincount(place) for column in squares[order].T])
    of_suture, count = squares[order].mean(1), np.bincount(place)
    spread = np.bincount(place, (of_suture - per_arm.mean(0)[place]) ** 2) / np.maximum(count - 1, 1)
    places = thetas[order][np.flatnonzero(np.diff(place, prepend=-1))]
    return Demonstrations(places, per_arm, source, np.sqrt(spread))


def load_demonstrations(path: str | Path) -> Demonstrations:
    """Return the demonstrations of a ``demonstrations.toml``, given as that file or its folder.

    Raises:
        BadFile: the manifest or a recording is missing or broken, or a recording contradicts the manifest.
    """
    from trocar.tasks.suture.demonstrations import recordings as of  # pydantic is slow to import

    path = Path(path) / NAME if Path(path).is_dir() else Path(path)
    manifest = of.load_manifest(path)
    source = manifest.source or f"demonstrations in {path.parent.name}"
    joints: dict[int, NDArray[np.float64]] = {}
    poses: dict[int, tuple[Path, SE3]] = {}
    for index, suture in enumerate(manifest.sutures):
        file, rows = path.parent / suture.file, slice(*(suture.rows or (None,)))
        if file.suffix not in (".csv", ".txt"):
            raise BadFile(file, f"ends in {file.suffix!r}", "recordings end in .csv or .txt")
        if not file.is_file() or file.stat().st_size == 0:
            problem = "is empty" if file.is_file() else "does not exist"
            raise BadFile(file, problem, "correct its name in the manifest, or copy it again", kind="recording")
        if file.suffix == ".csv":
            joints[index] = of.read_joints(file, rows, manifest)
            found = len(joints[index])
        else:
            poses[index] = file, of.read_jigsaws(file, rows, manifest)
            found = len(poses[index][1].matrix)
        if suture.rows and found < suture.rows[1] - suture.rows[0]:
            first, last = suture.rows
            raise BadFile(file, f"has {first + found} rows", f"the manifest asks for {first} to {last}")
    if poses:
        solved, assumed = of.joints_from_poses(list(poses.values()), manifest)
        joints |= dict(zip(poses, solved, strict=True))
        source = f"{source}; {assumed}"
    thetas = np.radians([suture.theta_deg for suture in manifest.sutures])
    return demonstrations_from_joints(thetas, [joints[index] for index in range(len(thetas))], manifest.models, source)


def synthetic_demonstrations() -> Demonstrations:
    """Return the small synthetic set that ships with the package; its ``source`` says that it is synthetic.

    ``tools/synthetic_sutures.py`` made it from the needle primitive with wandering hands.
    """
    with as_file(files(__name__) / "synthetic_set") as folder:
        return load_demonstrations(folder)
