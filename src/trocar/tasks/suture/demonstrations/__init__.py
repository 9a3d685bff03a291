"""Recorded sutures, and the manipulability of the arms in them, which is part of the reward (paper, IV-A2).

A set of demonstrations is a folder with a ``demonstrations.toml`` that gives the position of each recorded suture on
the circle, the arms that were recorded, and units and columns (``manifest``). Recordings are tables of joint states
(.csv) or JIGSAWS text.
"""

from importlib.resources import as_file, files

from trocar.tasks.suture.demonstrations.demonstrations import Demonstrations, demonstrations_from_joints
from trocar.tasks.suture.demonstrations.manifest import Manifest, RecordedSuture, load_demonstrations, load_manifest
from trocar.tasks.suture.demonstrations.recordings import Convention

__all__ = [
    "Convention",
    "Demonstrations",
    "Manifest",
    "RecordedSuture",
    "demonstrations_from_joints",
    "load_demonstrations",
    "load_manifest",
    "synthetic_demonstrations",
]


def synthetic_demonstrations() -> Demonstrations:
    """Return the small synthetic set that ships with the package; its ``source`` says that it is synthetic.

    ``tools/synthetic_sutures.py`` made it from the needle primitive with wandering hands.
    """
    with as_file(files("trocar.tasks.suture.demonstrations") / "synthetic_set") as folder:
        return load_demonstrations(folder)
