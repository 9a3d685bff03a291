"""ROS 2 topics over Cyclone DDS, on one named network interface, without multicast and without ROS."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable, Hashable
from functools import cache
from typing import Any, TypeVar, Unpack

from cyclonedds.core import Entity, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from trocar.crtk.bus import KEPT_UNREAD, Client, Endpoint, Keeping, Publisher, Subscriber, domain_of
from trocar.crtk.messages import CameraInfo, Image
from trocar.crtk.ros2_graph import Graph
from trocar.errors import InvalidInput
from trocar.lab.topics import Topics

KEPT = 10
"""Messages that a writer keeps for a slow reader (ROS 2's default)."""
LEAVE_S = 2.0
"""How long the end of a process waits until others have been told."""
FAST_DDS = "1.15"
"""Vendor whose type descriptions Cyclone cannot read (measured with rclpy of ROS 2 Kilted)."""
BUFFER = 1 << 23
"""Size of the receive buffer in bytes, if the system permits it: two images. Data that do not fit are sent again .1 s
later (measured)."""
CONFIGURATION = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="{interface}"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers>{peers}</Peers>
</Discovery><Internal><SocketReceiveBufferSize max="{buffer}B"/></Internal><Compatibility>
<IgnoreTypeInformation>{vendor}</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"""

Message = TypeVar("Message")


class Ros2Bus:
    """A participant in the topics of one ROS domain.

    Args:
        topics: interface, peers and domain.

    Raises:
        InvalidInput: the interface cannot be used, or ``ROS_DOMAIN_ID`` is no domain.
    """

    def __init__(self, topics: Topics):
        self._participant, self._graph = _participant(topics.interface, topics.peers, domain_of(topics))

    def publisher(self, topic: str, kind: type[Message], **keeping: Unpack[Keeping]) -> Publisher[Message]:
        """Return a publisher of a topic such as ``/PSM1/servo_jp``; see ``Bus``."""
        quality, kept_s = _quality(keeping.get("latched", False), keeping.get("kept") or KEPT), keeping.get("kept_s")
        if kept_s is not None:
            quality += Qos(Policy.Lifespan(duration(seconds=kept_s)))
        return _Writer(DataWriter(self._participant, self._topic(topic, kind), qos=quality))

    def subscriber(
        self, topic: str, kind: type[Message], *, latched: bool = False, kept: int = KEPT_UNREAD
    ) -> Subscriber[Message]:
        """Return a subscriber of a topic that keeps the newest ``kept`` messages until they are taken.

        It takes what cameras publish even if their driver neither keeps messages nor sends lost ones again.
        """
        about, wanted = self._topic(topic, kind), [latched, True]

        def reader() -> Any:
            return DataReader(self._participant, about, qos=_quality(wanted[0], kept, reliable=wanted[1]))

        return _CameraReader(reader, wanted, kept) if kind in (Image, CameraInfo) else _Reader(reader(), kept)

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers, of every program, discovered so far."""
        return self._graph.endpoints()

    def client(self, sender: Hashable) -> Client:
        """Return who one of a subscriber's ``sent_by`` is."""
        return self._graph.client(sender)

    def _topic(self, name: str, kind: type) -> Any:
        return Topic(self._participant, f"rt/{name.strip('/')}", kind)


@cache
def _participant(interface: str, peers: tuple[str, ...], domain: int) -> tuple[Any, Graph]:
    """Return this process's participant and its graph; a process can configure a domain only once."""
    hosts = "".join(f'<Peer address="{host}"/>' for host in (interface, *peers))
    text = CONFIGURATION.format(interface=interface, peers=hosts, vendor=FAST_DDS, buffer=BUFFER)
    try:
        configured = Domain(domain, text)
        participant = DomainParticipant(domain)
        atexit.register(_leave, participant, configured)
        return participant, Graph(participant)
    except Exception as error:
        problem = f"cannot be used ({error})"
        remedy = "give the address of one, the same everywhere in a process"
        raise InvalidInput(f"network interface {interface!r} in domain {domain}", problem, remedy) from None


def _leave(participant: Any, _domain: Any) -> None:
    """Tell others that this process leaves; everything else, the domain included, ends with the process.

    At the interpreter's end, Cyclone 11.0.1 was seen to hang while it deleted a domain, and once a reader.
    """
    leaving = threading.Thread(target=participant._delete, args=(participant._ref,), daemon=True)
    leaving.start()
    leaving.join(LEAVE_S)
    Entity._entities.clear()  # an object that is not listed there deletes nothing when it ends


class _Writer(Publisher[Message]):
    def __init__(self, writer: Any):
        self._writer = writer

    def send(self, message: Message) -> None:
        self._writer.write(message)

    def readers(self) -> int:
        return self._writer.get_publication_matched_status().current_count  # a list would change while it is made


class _Reader(Subscriber[Message]):
    def __init__(self, reader: Any, kept: int):
        super().__init__()
        self._reader, self._kept = reader, kept

    def senders(self) -> int:
        return self._reader.get_subscription_matched_status().current_count

    def _come(self) -> list[tuple[float, Hashable, Message]]:
        now_s = time.monotonic()
        samples = [one for one in self._reader.take(N=self._kept) if not isinstance(one, InvalidSample)]
        return [(now_s, sample.sample_info.publication_handle, sample) for sample in samples]


class _CameraReader(_Reader[Message]):
    """Lowers its quality of service where no publisher offers it: camera drivers differ, and scripts can ask again.

    A reader of an arm's state must not do so: it could miss a state, which is sent only when it changes.
    """

    DURABILITY = 2
    """Number of this policy in the DDS standard; the other that can be refused here is reliability."""

    def __init__(self, made: Callable[[], Any], wanted: list[bool], kept: int):
        super().__init__(made(), kept)
        self._made, self._wanted = made, wanted  # latched, reliable

    def _come(self) -> list[tuple[float, Hashable, Message]]:
        if not self.senders():
            refused = self._reader.get_requested_incompatible_qos_status()
            if refused.total_count_change:
                self._wanted[0 if refused.last_policy_id == self.DURABILITY else 1] = False
                self._reader = self._made()
        return super()._come()


def _quality(latched: bool, kept: int, *, reliable: bool = True) -> Any:
    durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
    sure = Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort
    return Qos(sure, Policy.History.KeepLast(kept), durability)
