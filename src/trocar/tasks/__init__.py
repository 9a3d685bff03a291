"""What is to be done: a scene and its score."""

from trocar.tasks.peg_transfer import PegTransfer

TASKS = {PegTransfer.name: PegTransfer}
"""Every task by its name on the command line."""

__all__ = ["TASKS", "PegTransfer"]
