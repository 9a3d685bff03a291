"""ROS 2 topics over Cyclone DDS, on one named network interface, without multicast."""

from __future__ import annotations

import os
import time
from functools import cache
from typing import Any, Generic, TypeVar

from trocar.errors import InvalidInput, NotInstalled

try:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.internal import InvalidSample
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
except ImportError:
    raise NotInstalled("CRTK over ROS 2", "cyclonedds", "crtk") from None

from trocar.crtk.messages import Header, Time

LOOPBACK = "127.0.0.1"
KEPT, KEPT_UNREAD = 10, 1000
"""Messages that a writer keeps for a slow reader (ROS 2's default), and that a reader keeps until they are taken."""
FAST_DDS = "1.15"
"""Vendor whose descriptions of types Cyclone cannot read (measured with rclpy of ROS 2 Kilted)."""
CONFIGURATION = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="{interface}"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers>{peers}</Peers>
</Discovery><Compatibility><IgnoreTypeInformation>{vendor}</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"""

DOMAINS: list[Any] = []
"""Kept, since a domain ends with its object."""
Message = TypeVar("Message")


class Bus:
    """A participant in the topics of one ROS domain.

    Args:
        interface: address of the network interface; the loopback interface reaches this machine alone.
        peers: addresses of other machines to speak with; there is no multicast.
        domain: ``ROS_DOMAIN_ID``.

    Raises:
        InvalidInput: the interface cannot be used.
    """

    def __init__(self, interface: str = LOOPBACK, peers: tuple[str, ...] = (), domain: int | None = None):
        self._participant = _participant(
            interface, peers, int(os.environ.get("ROS_DOMAIN_ID", "0")) if domain is None else domain
        )

    def publisher(self, topic: str, kind: type[Message], *, latched: bool = False) -> Publisher[Message]:
        """Return a publisher of a topic such as ``/PSM1/servo_jp``; latched: late readers get the last message."""
        return Publisher(DataWriter(self._participant, self._topic(topic, kind), qos=_quality(latched, KEPT)))

    def subscriber(self, topic: str, kind: type[Message], *, latched: bool = False) -> Subscriber[Message]:
        """Return a subscriber of a topic."""
        return Subscriber(DataReader(self._participant, self._topic(topic, kind), qos=_quality(latched, KEPT_UNREAD)))

    def _topic(self, name: str, kind: type) -> Any:
        return Topic(self._participant, f"rt/{name.strip('/')}", kind)


@cache
def _participant(interface: str, peers: tuple[str, ...], domain: int) -> Any:
    """Return this process's participant: a domain can be configured once in a process."""
    hosts = "".join(f'<Peer address="{host}"/>' for host in (interface, *peers))
    text = CONFIGURATION.format(interface=interface, peers=hosts, vendor=FAST_DDS)
    try:
        DOMAINS.append(Domain(domain, text))
        return DomainParticipant(domain)
    except Exception as error:
        problem = f"cannot be used ({error})"
        remedy = "give the address of one, the same everywhere in a process"
        raise InvalidInput(f"network interface {interface!r} in domain {domain}", problem, remedy) from None


class Publisher(Generic[Message]):
    """Sends messages of one topic."""

    def __init__(self, writer: Any):
        self._writer = writer

    def send(self, message: Message) -> None:
        """Send one."""
        self._writer.write(message)


class Subscriber(Generic[Message]):
    """Receives messages of one topic.

    Attributes:
        last: the newest message so far; None before the first.
        at_s: the machine's monotonic clock when it was taken.
    """

    def __init__(self, reader: Any):
        self._reader = reader
        self.last: Message | None = None
        self.at_s = 0.0

    def take(self) -> list[Message]:
        """Return what has come since the last call, oldest first."""
        come = [sample for sample in self._reader.take(N=KEPT_UNREAD) if not isinstance(sample, InvalidSample)]
        if come:
            self.last, self.at_s = come[-1], time.monotonic()
        return come


def _quality(latched: bool, kept: int) -> Any:
    durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
    return Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(kept), durability)


def stamped(frame: str = "") -> Header:
    """Return a header of now."""
    now_ns = time.time_ns()
    return Header(Time(now_ns // 1_000_000_000, now_ns % 1_000_000_000), frame)
