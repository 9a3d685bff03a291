"""Transmissions, which lie between an encoder and its joint: identified cables, or a field of errors."""

from trocar.calibration.plant import PLANTS, PSM1_GREY_SESSIONS
from trocar.lab.transmission.base import DriveTrain, JawCable, Stiff, Transmission
from trocar.lab.transmission.cables import Cables
from trocar.lab.transmission.pose_error_field import PoseErrorField
from trocar.registry import Registry

SESSIONS = {"psm1_grey": PSM1_GREY_SESSIONS}
"""Means over the recorded sessions, for instruments with several sessions."""

TRANSMISSIONS: Registry[Transmission] = Registry(
    "transmission",
    "trocar.transmissions",
    {name: Cables(plant, usual=SESSIONS.get(name)) for name, plant in PLANTS.items()}
    | {"raven2": PoseErrorField(), "stiff": Stiff()},
)
"""The transmissions that a station's arm can have, by name."""

__all__ = ["TRANSMISSIONS", "Cables", "DriveTrain", "JawCable", "PoseErrorField", "Stiff", "Transmission"]
