"""The pose of a suture needle, from depth images of one moment."""

from trocar.perception.needle.arc import NeedleArc
from trocar.perception.needle.sighting import NeedleSighting, search_starts, sight_needle

__all__ = ["NeedleArc", "NeedleSighting", "search_starts", "sight_needle"]
