"""Kinds of real robots that a command line can name: ``--robot crtk:STATION.toml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from trocar.errors import InvalidInput
from trocar.hardware.laboratory import HardwareLaboratory
from trocar.lab import Station
from trocar.registry import Lazy, Registry

Listener = Callable[[Mapping[str, object]], None]


@dataclass(frozen=True)
class RobotKind:
    """One kind of real robot.

    Attributes:
        about: one-line description.
        connect: connects the arms and cameras of a station; takes the station and a listener for each event.
        where: says how an arm of a station is reached and what is sent to it; a person reads this before the arm moves.
    """

    about: str
    connect: Callable[[Station, Listener | None], HardwareLaboratory]
    where: Callable[[Station, str], str]


def _require(name: str, kind: object) -> None:
    if not isinstance(kind, RobotKind):
        raise InvalidInput(f"robot {name!r}", f"is {kind!r}", "register a trocar.hardware.kinds.RobotKind")


ROBOTS: Registry[RobotKind] = Registry(
    "robot", "trocar.robots", {"crtk": Lazy("trocar.crtk.laboratory:CRTK")}, check=_require
)
"""Kinds of real robots by name."""


def robot_of(text: str) -> tuple[RobotKind, str]:
    """Return the kind of robot and the station's file that ``KIND:STATION.toml`` names.

    Raises:
        InvalidInput: the text has another form, or there is no such kind.
    """
    name, colon, station = text.partition(":")
    if not colon or not station:
        raise InvalidInput(f"--robot {text}", "names no station's file", "give KIND:STATION.toml, as crtk:mine.toml")
    return ROBOTS.pick(name), station
