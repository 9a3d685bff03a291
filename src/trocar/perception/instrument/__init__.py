"""The wrist joints of an instrument, from one depth image of it."""

from trocar.perception.instrument.sighting import Sighting, sight

__all__ = ["Sighting", "sight"]
