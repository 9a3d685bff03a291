"""The pose of a suture needle, from depth images of one moment."""

from trocar.tasks.suture.perception.arc import NeedleArc
from trocar.tasks.suture.perception.sighting import NeedleSighting, search_starts, sight_needle

__all__ = ["NeedleArc", "NeedleSighting", "search_starts", "sight_needle"]
