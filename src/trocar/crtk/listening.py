"""Listen to a robot without touching it: what its arms and cameras publish, and who is there."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from trocar.crtk.bus import Bus, Endpoint, Subscriber
from trocar.crtk.dialect import command_of, held_topic, jaw_topic, pose_kind, state_kind
from trocar.crtk.images import parts_of
from trocar.crtk.messages import CameraInfo, Empty, Image, JointState, StringStamped
from trocar.lab.station import Station
from trocar.lab.topics import Dialect, Topics

POLL_S = 0.001
BLIND_S = 0.015
"""A message that is found after this long without a look may have come long before."""
KEPT_IMAGES = 3
Message = tuple[float, Any]
"""Time of arrival on the machine's clock, s since 1970, and the message."""


@dataclass(frozen=True)
class Wanted:
    """A topic of a robot.

    Attributes:
        kind: of its messages.
        latched: late readers get the last message.
        needed: every robot has it; else robots of other dialects may lack it.
        kept: number of messages that may wait to be taken.
    """

    kind: type
    latched: bool = False
    needed: bool = True
    kept: int = 1000


def published_by(arm: str, topics: Topics) -> dict[str, Wanted]:
    """Return what an arm publishes, by its full topic."""
    topic, dialect = topics.of_arm(arm), topics.dialect
    jaw, modern = jaw_topic(dialect, topic), dialect is Dialect.DVRK
    found = {f"{topic}/operating_state": Wanted(state_kind(dialect), latched=True)}
    for place in (topic, jaw):
        found |= {f"{place}/{what}": Wanted(JointState) for what in ("measured_js", held_topic(dialect))}
    poses = ("local/measured_cp", "measured_cp", "setpoint_cp")
    return found | {f"{topic}/{what}": Wanted(pose_kind(dialect), needed=modern) for what in poses}


def heard_by(arm: str, topics: Topics) -> dict[str, type]:
    """Return the message types of the commands that an arm must take from its loop, by full topic."""
    topic, raven = topics.of_arm(arm), topics.dialect is Dialect.RAVEN
    kinds: dict[str, type] = {f"{topic}/{command_of(topics)}": JointState}
    if raven:  # its jaws' joints are among the arm's
        return kinds
    kinds[f"{jaw_topic(topics.dialect, topic)}/{topics.command.value}"] = JointState
    return kinds | {f"{topic}/state_command": StringStamped, f"{topic}/hold": Empty}


def motion_prefixes(arm: str, topics: Topics) -> tuple[str, ...]:
    """Return the prefixes of all topics that move an arm."""
    topic = topics.of_arm(arm)
    places = (topic, jaw_topic(topics.dialect, topic))
    return tuple(f"{place}/{verb}" for place in places for verb in ("servo_", "move_"))


def shown_by(camera: str, station: Station, topics: Topics) -> dict[str, Wanted]:
    """Return what a camera publishes: images of both parts, and its lens."""
    topic, parts = topics.of_camera(camera), parts_of(station.cameras[camera].model)
    found = {f"{topic}/{part}/image_raw": Wanted(Image, kept=KEPT_IMAGES) for part in parts}
    return found | {f"{topic}/{parts[0]}/camera_info": Wanted(CameraInfo, latched=True)}


@dataclass(frozen=True)
class Heard:
    """What was heard.

    Attributes:
        messages: of each topic, in the order in which they came.
        endpoints: publishers and subscribers that were there.
        pause_s: longest time for which other programs held the listener up; its own work does not count.
        blind_s: by the time of each late look, the time since the look before; what it found came within this time.
        end_s: time of the last look on the machine's clock; a topic of which nothing came since its last message has
            ended, or pauses.
    """

    messages: Mapping[str, Sequence[Message]]
    endpoints: Sequence[Endpoint]
    pause_s: float = 0.0
    blind_s: Mapping[float, float] = field(default_factory=dict)
    end_s: float = -math.inf


class Listener:
    """Subscribes to what arms and cameras publish; never publishes anything.

    Args:
        bus: to listen on.
        station: of the robot.
        topics: of its arms and cameras.
        arms: names of the arms to listen to.
        cameras: names of the cameras to listen to.
    """

    def __init__(self, bus: Bus, station: Station, topics: Topics, arms: Sequence[str], cameras: Sequence[str] = ()):
        self._bus = bus
        wanted = {topic: one for arm in arms for topic, one in published_by(arm, topics).items()}
        wanted |= {topic: one for camera in cameras for topic, one in shown_by(camera, station, topics).items()}
        self._sources: dict[str, Subscriber[Any]] = {
            topic: bus.subscriber(topic, one.kind, latched=one.latched, kept=one.kept) for topic, one in wanted.items()
        }
        self._messages: dict[str, list[Message]] = {topic: [] for topic in wanted}
        self._last_s, self._pause_s, self._blind_s = -math.inf, 0.0, dict[float, float]()

    def take(self, now_s: float, pause_s: float = 0.0) -> None:
        """Take the messages that have come.

        Args:
            now_s: the machine's clock, s since 1970.
            pause_s: time for which other programs have held the listener up since the last call.
        """
        self._pause_s = max(self._pause_s, pause_s)
        if now_s - self._last_s > BLIND_S:
            self._blind_s[now_s] = now_s - self._last_s
        self._last_s = now_s
        for topic, source in self._sources.items():
            self._messages[topic] += [(now_s, _without_pixels(message)) for message in source.take()]

    def heard(self) -> Heard:
        """Return what has been heard so far."""
        return Heard(self._messages, self._bus.endpoints(), self._pause_s, self._blind_s, self._last_s)


def _without_pixels(message: Any) -> Any:
    """Return a message as it is kept: no check needs an image's pixels, which would fill the memory."""
    return replace(message, data=b"") if isinstance(message, Image) else message


def listen(listener: Listener, seconds: float) -> Heard:
    """Listen for a time."""
    end_s, pause_s = time.monotonic() + seconds, 0.0
    gc.disable()  # each collection would scan all that was heard, for a tenth of a second
    try:
        while (began_s := time.monotonic()) < end_s:
            worked_s = time.process_time()
            listener.take(time.time(), pause_s)
            time.sleep(POLL_S)
            pause_s = time.monotonic() - began_s - (time.process_time() - worked_s) - POLL_S
    finally:
        gc.enable()
    return listener.heard()
