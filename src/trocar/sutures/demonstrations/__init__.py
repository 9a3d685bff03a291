"""Recordings of sutures, and how well the arms could move in them: the manipulability reward (paper, IV-A2).

A set of demonstrations is a folder with a ``demonstrations.toml`` that says where round the circle each recorded suture
stands, which arms were recorded and how the numbers are meant (``manifest``); recordings are NumPy arrays or CSV of
joint states, JIGSAWS text or LeRobot parquet (``READERS``).
"""

from trocar.sutures.demonstrations.convention import Convention
from trocar.sutures.demonstrations.demonstrations import Demonstrations
from trocar.sutures.demonstrations.manifest import Manifest, RecordedSuture, load_demonstrations, load_manifest
from trocar.sutures.demonstrations.readers import READERS
from trocar.sutures.demonstrations.synthetic import synthetic_demonstrations

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
