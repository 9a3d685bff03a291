"""Recorded sutures, and the manipulability of the arms in them, which is part of the reward (paper, IV-A2).

A set of demonstrations is a folder with a ``demonstrations.toml`` that gives the position of each recorded suture on
the circle, the arms that were recorded, and units and columns (``manifest``). Recordings are NumPy arrays or CSV of
joint states, JIGSAWS text, or LeRobot parquet (``READERS``).
"""

from trocar.tasks.suture.demonstrations.convention import Convention
from trocar.tasks.suture.demonstrations.demonstrations import Demonstrations
from trocar.tasks.suture.demonstrations.manifest import Manifest, RecordedSuture, load_demonstrations, load_manifest
from trocar.tasks.suture.demonstrations.readers import READERS
from trocar.tasks.suture.demonstrations.synthetic import synthetic_demonstrations

__all__ = [
    "READERS",
    "Convention",
    "Demonstrations",
    "Manifest",
    "RecordedSuture",
    "load_demonstrations",
    "load_manifest",
    "synthetic_demonstrations",
]
