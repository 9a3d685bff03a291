"""Where a suture needle is, from one depth image of it."""

from trocar.perception.needle.arc import NeedleArc
from trocar.perception.needle.sighting import NeedleSighting, sight_needle

__all__ = ["NeedleArc", "NeedleSighting", "sight_needle"]
