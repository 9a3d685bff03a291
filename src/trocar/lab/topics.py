"""Where the arms and cameras of a laboratory speak CRTK: names, network, dialect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

LOOPBACK = "127.0.0.1"
"""The interface that reaches this machine alone."""
MAX_DOMAIN = 232
"""The ports of higher ROS domains are out of range."""


class Dialect(Enum):
    """How an arm's topics are named and typed."""

    DVRK = "dvrk"
    """CRTK 1.1 and later: ``crtk_msgs/OperatingState``, poses as ``PoseStamped`` (dVRK 2.0 and later)."""
    CRTK_1_0 = "crtk-1.0"
    """Before: ``crtk_msgs/operating_state``, poses as ``TransformStamped``."""
    RAVEN = "raven"
    """Raven II: as before 1.1, moved by increments (``servo_jr``), its jaws beside it as ``/grasp1`` for ``/arm1``."""


class Command(Enum):
    """How arms are commanded."""

    SERVO = "servo_jp"
    """A set-point a tick."""
    MOVE = "move_jp"
    """A goal a tick, towards which the arm plans its own way: for one that does not take a stream."""


@dataclass(frozen=True)
class Topics:
    """Where the arms and cameras of a laboratory are found.

    Attributes:
        ros: 1 or 2.
        arms: namespace of each arm's topics; an arm that is not here has its name in capitals: ``/PSM1``.
        cameras: namespace of each camera's topics; one that is not here has its name: ``/overhead``.
        dialect: of all arms.
        command: how they are commanded.
        loop: what the loop of real arms tolerates, by the names of ``trocar.hardware.LoopSettings``, where it is not
            the usual.
        interface: address of this machine's network interface.
        peers: addresses of other machines to speak with (ROS 2).
        domain: ``ROS_DOMAIN_ID``; None: the environment's (ROS 2).
        master: address of the master (ROS 1).
    """

    ros: int = 2
    arms: Mapping[str, str] = field(default_factory=dict)
    cameras: Mapping[str, str] = field(default_factory=dict)
    dialect: Dialect = Dialect.DVRK
    command: Command = Command.SERVO
    loop: Mapping[str, float] = field(default_factory=dict)
    interface: str = LOOPBACK
    peers: tuple[str, ...] = ()
    domain: int | None = None
    master: str = f"http://{LOOPBACK}:11311"

    def of_arm(self, arm: str) -> str:
        """Return an arm's namespace."""
        return self.arms.get(arm, f"/{arm.upper()}").rstrip("/")

    def of_camera(self, camera: str) -> str:
        """Return a camera's namespace."""
        return self.cameras.get(camera, f"/{camera}").rstrip("/")
