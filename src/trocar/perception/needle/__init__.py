"""Where a suture needle is, from one depth image of it."""

from trocar.perception.needle.arc import NeedleArc
from trocar.perception.needle.sighting import NeedleSighting, search_starts, sight_needle

__all__ = ["NeedleArc", "NeedleSighting", "search_starts", "sight_needle"]
