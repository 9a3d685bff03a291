"""What is to be done: a scene and its score."""

from trocar.tasks.peg_transfer import PegTransfer
from trocar.tasks.suture import CircleSutures

TASKS = {PegTransfer.name: PegTransfer, CircleSutures.name: CircleSutures}
"""Every task by its name on the command line."""

__all__ = ["TASKS", "CircleSutures", "PegTransfer"]
