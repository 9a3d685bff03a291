"""Topics of a robot: what is common to ROS 1 and ROS 2."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, Protocol, TypedDict, TypeVar, Unpack

from trocar.errors import InvalidValue, NotInstalled
from trocar.lab.topics import MAX_DOMAIN, Topics

try:
    from trocar.crtk.messages import Header, Time
except ImportError:
    raise NotInstalled("CRTK", "cyclonedds", "crtk") from None

KEPT_UNREAD = 1000
"""Number of untaken messages that a subscriber keeps by default; beyond it, the oldest are lost."""
Message = TypeVar("Message")


@dataclass(frozen=True)
class Client:
    """A sender, by its own account: ROS does not verify names.

    Attributes:
        node: its ROS name, such as ``/console``; empty if it has none.
        addresses: of its machine.
        process: its id on that machine; empty if unknown.
    """

    node: str = ""
    addresses: tuple[str, ...] = ()
    process: str = ""

    def __str__(self) -> str:
        process = f"process {self.process}" if self.process else "somebody unknown"
        return f"{self.node or process} on {', '.join(self.addresses) or 'an unknown machine'}"


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscriber somewhere.

    Attributes:
        topic: such as ``/PSM1/servo_jp``.
        kind: its message, such as ``sensor_msgs/JointState``; empty if unknown.
        publishes: whether it is a publisher; else it is a subscriber.
        client: that it belongs to.
    """

    topic: str
    kind: str
    publishes: bool
    client: Client


class Keeping(TypedDict, total=False):
    """What a publisher keeps for readers.

    Attributes:
        latched: late readers get the last message.
        kept_s: but not if it is older than this (ROS 1: then they get none).
        kept: number of newest messages that wait for a slow reader; None: as usual.
    """

    latched: bool
    kept_s: float | None
    kept: int | None


class Bus(Protocol):
    """A participant in the topics of a robot."""

    def publisher(self, topic: str, kind: type[Message], **keeping: Unpack[Keeping]) -> Publisher[Message]:
        """Return a publisher of a topic such as ``/PSM1/servo_jp``, whose messages are of this kind."""
        ...

    def subscriber(
        self, topic: str, kind: type[Message], *, latched: bool = False, kept: int = KEPT_UNREAD
    ) -> Subscriber[Message]:
        """Return a subscriber of a topic that keeps the newest ``kept`` messages until they are taken."""
        ...

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers, of every program, discovered so far."""
        ...

    def client(self, sender: Hashable) -> Client:
        """Return who one of a subscriber's ``sent_by`` is."""
        ...


class Publisher(ABC, Generic[Message]):
    """Sends messages of one topic."""

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send one."""

    @abstractmethod
    def readers(self) -> int:
        """Return the number of subscribers of the topic."""


class Subscriber(ABC, Generic[Message]):
    """Receives messages of one topic.

    Attributes:
        last: the newest message so far; None before the first.
        at_s: the machine's monotonic clock when ``last`` arrived, or was taken, if that is not known.
        sent_by: who sent each message of the last ``take``; ``Bus.client`` tells who that is.
    """

    def __init__(self) -> None:
        self.last: Message | None = None
        self.at_s = 0.0
        self.sent_by: list[Hashable] = []

    def take(self) -> list[Message]:
        """Return what has come since the last call, oldest first."""
        come = self._come()
        self.sent_by = [sender for _, sender, _ in come]
        if come:
            self.at_s, _, self.last = come[-1]
        return [message for _, _, message in come]

    @abstractmethod
    def senders(self) -> int:
        """Return how many publishers it is connected to now."""

    @abstractmethod
    def _come(self) -> list[tuple[float, Hashable, Message]]:
        """Return when each message came, who sent it, and the message."""


def open_bus(topics: Topics) -> Bus:
    """Return a participant in a station's topics.

    Raises:
        TrocarError: the interface or the master cannot be used, or ROS 1 is not there.
    """
    if topics.ros == 1:
        from trocar.crtk.ros1 import Ros1Bus

        return Ros1Bus(topics)
    from trocar.crtk.ros2 import Ros2Bus

    return Ros2Bus(topics)


def domain_of(topics: Topics) -> int:
    """Return the ROS 2 domain of a station's topics: their own, or that of ``ROS_DOMAIN_ID``, which is 0 if empty.

    Raises:
        InvalidValue: ``ROS_DOMAIN_ID`` is no domain.
    """
    if topics.domain is not None:
        return topics.domain
    told = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (told.isdecimal() and int(told) <= MAX_DOMAIN):
        raise InvalidValue("ROS_DOMAIN_ID", told, f"set it to 0 to {MAX_DOMAIN}, or unset it")
    return int(told)


def stamped(frame: str = "", now_s: float | None = None) -> Header:
    """Return a header of this time, or of now."""
    now_ns = time.time_ns() if now_s is None else round(1e9 * now_s)
    return Header(Time(now_ns // 1_000_000_000, now_ns % 1_000_000_000), frame)
