"""The pose of a suture needle, from depth images of one moment."""

from trocar.tasks.suture.perception.needle_pose import NeedleSighting, search_starts, sight_needle

__all__ = ["NeedleSighting", "search_starts", "sight_needle"]
