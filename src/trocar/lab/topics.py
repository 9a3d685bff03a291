"""Where the arms and cameras of a laboratory are found on CRTK: names, network, dialect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

LOOPBACK = "127.0.0.1"
"""The interface that reaches this machine alone."""
MAX_DOMAIN = 232
"""Highest ROS domain; the ports of higher ones are out of range."""


class Dialect(Enum):
    """How an arm's topics are named and typed."""

    DVRK = "dvrk"
    """CRTK 1.1 and later: ``crtk_msgs/OperatingState``, poses as ``PoseStamped`` (dVRK 2.0 and later)."""
    CRTK_1_0 = "crtk-1.0"
    """CRTK before 1.1: ``crtk_msgs/operating_state``, poses as ``TransformStamped``."""
    RAVEN = "raven"
    """Raven II: like CRTK 1.0, but moved by increments (``servo_jr``), and with jaws as ``/grasp1`` for ``/arm1``."""


class Command(Enum):
    """How arms are commanded."""

    SERVO = "servo_jp"
    """One set-point per tick."""
    MOVE = "move_jp"
    """One goal per tick, towards which the arm plans its own motion; for arms that take no stream of set-points."""


@dataclass(frozen=True)
class Topics:
    """Where the arms and cameras of a laboratory are found.

    Attributes:
        ros: version of ROS, 1 or 2.
        arms: namespace of each arm's topics; by default the arm's name in capitals: ``/PSM1``.
        cameras: namespace of each camera's topics; by default the camera's name: ``/overhead``.
        dialect: dialect of all arms.
        command: how the arms are commanded.
        loop: settings of the control loop that differ from the defaults of ``trocar.hardware.LoopSettings``.
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
