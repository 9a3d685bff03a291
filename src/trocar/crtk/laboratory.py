"""Arms and cameras of a station that speak CRTK, as a laboratory that runs scripts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from typing import Any

from trocar.crtk.arm import connect
from trocar.crtk.camera import CrtkCamera
from trocar.crtk.dialect import command_of
from trocar.errors import UnknownName
from trocar.hardware import HardwareLaboratory, LoopSettings
from trocar.hardware.kinds import RobotKind
from trocar.lab import Station
from trocar.lab.topics import Dialect, Topics

RAVEN_TICK_S = 0.005
"""A Raven that has heard nothing for 10 ms leaves joint control (uw-biorobotics/raven2, branch crtk, rt_raven.cpp)."""


def laboratory(station: Station, listener: Callable[[Mapping[str, object]], None] | None = None) -> HardwareLaboratory:
    """Connect the cameras and arms of a station.

    Raises:
        TrocarError: one of them cannot be connected, or is not as the station describes it.
    """
    settings, topics = loop_settings(station.crtk), station.crtk
    cameras = {name: CrtkCamera(name, camera.model_registered, topics) for name, camera in station.cameras.items()}
    made = HardwareLaboratory(station, partial(connect, topics=topics), settings, cameras=cameras, listener=listener)
    for camera in cameras.values():
        camera.now_s = made.cell.clock.now_s
    return made


def loop_settings(topics: Topics) -> LoopSettings:
    """Return the loop's settings, as the station's table ``crtk.loop`` has them; a Raven's ticks are shorter.

    Raises:
        InvalidInput: it has no such setting, or the value is out of bounds.
    """
    kinds: dict[str, Any] = {field.name: type(field.default) for field in fields(LoopSettings)}
    for name in topics.loop:
        if name not in kinds:
            raise UnknownName("the station's crtk.loop: setting", name, kinds)
    usual: dict[str, Any] = {"tick_s": RAVEN_TICK_S} if topics.dialect is Dialect.RAVEN else {}
    for name, value in topics.loop.items():  # numbers of a station's file are floats
        usual[name] = int(value) if kinds[name] is int and float(value).is_integer() else value
    return LoopSettings(**usual)


def where(station: Station, arm: str) -> str:
    """Return in words how an arm is reached, and what is sent to it."""
    topics = station.crtk
    domain = "of the environment" if topics.domain is None else topics.domain
    network = f"master {topics.master}" if topics.ros == 1 else f"domain {domain}"
    topic, rate_hz = f"{topics.of_arm(arm)}/{command_of(topics)}", 1 / loop_settings(topics).tick_s
    return f"{topic} over ROS {topics.ros} on {topics.interface}, {network}, at {rate_hz:.0f} Hz"


CRTK = RobotKind("arms and cameras that speak CRTK, as the station's table [crtk] says", laboratory, where)
