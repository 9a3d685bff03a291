"""Arms and cameras of a station that speak CRTK, as a laboratory that runs scripts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from trocar.crtk.arm import CrtkArm
from trocar.crtk.camera import CrtkCamera
from trocar.crtk.dialect import command_of, loop_settings
from trocar.hardware import HardwareLaboratory
from trocar.hardware.kinds import RobotKind
from trocar.lab import Station


def laboratory(station: Station, listener: Callable[[Mapping[str, object]], None] | None = None) -> HardwareLaboratory:
    """Connect the cameras and arms of a station.

    Raises:
        TrocarError: one of them cannot be connected, or is not as the station describes it.
    """
    settings, topics = loop_settings(station.crtk), station.crtk
    cameras = {name: CrtkCamera(name, camera.model_registered, topics) for name, camera in station.cameras.items()}
    made = HardwareLaboratory(station, partial(CrtkArm, topics=topics), settings, cameras=cameras, listener=listener)
    for camera in cameras.values():
        camera.now_s = made.cell.clock.now_s
    return made


def where(station: Station, arm: str) -> str:
    """Return in words how an arm is reached, and what is sent to it."""
    topics = station.crtk
    domain = "of the environment" if topics.domain is None else topics.domain
    network = f"master {topics.master}" if topics.ros == 1 else f"domain {domain}"
    topic, rate_hz = f"{topics.of_arm(arm)}/{command_of(topics)}", 1 / loop_settings(topics).tick_s
    return f"{topic} over ROS {topics.ros} on {topics.interface}, {network}, at {rate_hz:.0f} Hz"


CRTK = RobotKind("arms and cameras that speak CRTK, as the station's table [crtk] says", laboratory, where)
