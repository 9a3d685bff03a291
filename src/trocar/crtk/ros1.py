"""ROS 1 topics through rospy, where it is installed (Debian: ``python3-rospy``)."""

from __future__ import annotations

import importlib
import os
import socket
import time
from collections import deque
from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from functools import cache
from http.client import HTTP_PORT, HTTPException
from typing import Any, TypeVar, Unpack
from urllib.parse import urlsplit
from xmlrpc.client import Error as XmlError

from trocar.crtk.bus import KEPT_UNREAD, Client, Endpoint, Keeping, Publisher, Subscriber
from trocar.crtk.messages import Time, ros_name
from trocar.errors import InvalidInput
from trocar.lab.topics import Topics

try:
    import rosgraph  # type: ignore[import-not-found]
    import rospy  # type: ignore[import-not-found]
    from genpy.dynamic import generate_dynamic  # type: ignore[import-not-found]
except ImportError:
    problem = "needs rospy in this Python, and PyPI has none"
    raise InvalidInput("CRTK over ROS 1", problem, "install a ROS 1, on Debian python3-rospy") from None

PERIODS = "".join(
    f"float64 {what}_{of}\n" for what in ("period", "compute_time") for of in ("avg", "std_dev", "min", "max")
)
COUNTS = "int64 number_of_samples\nint64 number_of_overruns\nfloat64 statistics_interval\nint64 user_data\n"
HEADER = f"{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
DEFINITIONS = {
    "StringStamped": f"std_msgs/Header header\nstring string\n{HEADER}",
    "OperatingState": f"std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n{HEADER}",
    "operating_state": f"std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n{HEADER}",
    "IntervalStatistics": f"std_msgs/Header header\n{PERIODS}{COUNTS}{HEADER}",
}
"""Messages of crtk_msgs 1.3 and cisst_msgs 4.0, which are not packaged; their checksums follow from these texts."""
BUFFER = 1 << 24
"""Bytes that rospy reads at once: an image in one piece."""
REACHED_S = 5.0
"""How long a master's machine has to accept a connection."""
UNANSWERED = (rosgraph.MasterException, OSError, HTTPException, XmlError)
"""What a call of the master raises if it knows no answer, has ended, or is something else."""
Message = TypeVar("Message")


class Ros1Bus:
    """A node in the graph of a ROS 1 master.

    Args:
        topics: interface and master.

    Raises:
        InvalidInput: nobody answers at the master's address.
    """

    def __init__(self, topics: Topics):
        self._master = topics.master
        _node(topics.interface, topics.master)

    def publisher(self, topic: str, kind: type[Message], **keeping: Unpack[Keeping]) -> Publisher[Message]:
        """Return a publisher of a topic such as ``/PSM1/servo_jp``; see ``Bus``."""
        latched = keeping.get("latched", False) and keeping.get("kept_s") is None
        waiting = keeping.get("kept") or KEPT_UNREAD
        return _Publisher(rospy.Publisher(topic, _class(kind), queue_size=waiting, latch=latched, tcp_nodelay=True))

    def subscriber(
        self, topic: str, kind: type[Message], *, latched: bool = False, kept: int = KEPT_UNREAD
    ) -> Subscriber[Message]:
        """Return a subscriber of a topic that keeps the newest ``kept`` messages until they are taken."""
        del latched  # in ROS 1, the publisher alone decides
        return _Subscriber(topic, kind, kept)

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers that the master knows.

        Raises:
            InvalidInput: the master has ended.
        """
        master = rosgraph.Master("/trocar")
        try:
            publishers, subscribers, _ = master.getSystemState()
            kinds = dict(master.getTopicTypes())
        except UNANSWERED:
            raise _silent(self._master, "does not answer any more", "start roscore and the robot again") from None
        return [
            Endpoint(topic, kinds.get(topic, ""), publishes, self.client(node))
            for publishes, topics in ((True, publishers), (False, subscribers))
            for topic, nodes in topics
            for node in nodes
        ]

    def client(self, sender: Hashable) -> Client:
        """Return who one of a subscriber's ``sent_by`` is."""
        try:
            address = urlsplit(rosgraph.Master("/trocar").lookupNode(str(sender))).hostname
        except UNANSWERED:  # the sender or the master has gone
            address = None
        return Client(str(sender), (address,) if address else ())


@cache
def _node(interface: str, master: str) -> None:
    """Make this process a node: ROS 1 allows one per process."""
    os.environ |= {"ROS_MASTER_URI": master, "ROS_HOSTNAME": interface, "ROS_IP": interface}
    if not (_is_reached(master) and rosgraph.is_master_online()):
        raise _silent(master, "does not answer", "start roscore, or name another")
    rospy.init_node("trocar", anonymous=True, disable_signals=True, disable_rostime=True, disable_rosout=True)


def _is_reached(master: str) -> bool:
    """Return whether something soon accepts connections at an address; rosgraph would try for two minutes."""
    try:
        place = urlsplit(master)
        with socket.create_connection((place.hostname, place.port or HTTP_PORT), REACHED_S):
            return True
    except (OSError, ValueError):  # the latter: it is no address
        return False


def _silent(master: str, problem: str, remedy: str) -> InvalidInput:
    return InvalidInput(f"the ROS 1 master at {master}", problem, remedy)


@cache
def _class(kind: type) -> Any:
    """Return rospy's class of a message."""
    whole = ros_name(kind)
    package, _, name = whole.partition("/")
    if name in DEFINITIONS:
        return generate_dynamic(whole, DEFINITIONS[name])[whole]
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError:
        debian = f"python3-{package.replace('_', '-')}"
        raise InvalidInput("CRTK over ROS 1", f"needs the messages {package}", f"install {debian} of Debian") from None


class _Publisher(Publisher[Message]):
    def __init__(self, publisher: Any):
        self._publisher = publisher

    def send(self, message: Message) -> None:
        self._publisher.publish(_filled(self._publisher.data_class(), message))

    def readers(self) -> int:
        return self._publisher.get_num_connections()


class _Subscriber(Subscriber[Message]):
    def __init__(self, topic: str, kind: type[Message], kept: int):
        super().__init__()
        self._kind = kind
        self._unread: deque[tuple[float, Any]] = deque(maxlen=kept)
        self._subscriber = rospy.Subscriber(topic, _class(kind), self._hear, buff_size=BUFFER, tcp_nodelay=True)

    def senders(self) -> int:
        return self._subscriber.get_num_connections()

    def _hear(self, message: Any) -> None:
        self._unread.append((time.monotonic(), message))

    def _come(self) -> list[tuple[float, Hashable, Message]]:
        come = []
        while self._unread:
            at_s, message = self._unread.popleft()
            come.append((at_s, message._connection_header["callerid"], _read(self._kind(), message)))
        return come


def _filled(target: Any, message: Any) -> Any:
    """Return rospy's message with the values of ours."""
    if isinstance(message, Time):
        target.secs, target.nsecs = message.sec, message.nanosec
        return target
    for field in fields(message):
        name, value = _name_in(target, field.name), getattr(message, field.name)
        if name is not None:
            setattr(target, name, _rospy(getattr(target, name), value))
    return target


def _rospy(target: Any, value: Any) -> Any:
    """Return a value of ours as rospy's."""
    if isinstance(value, list) and value and is_dataclass(value[0]):
        return [_filled(_class(type(one))(), one) for one in value]
    return _filled(target, value) if is_dataclass(value) else value


def _read(target: Any, message: Any) -> Any:
    """Return our message with the values of rospy's."""
    if isinstance(target, Time):
        return Time(message.secs, message.nsecs)
    for field in fields(target):
        name, value = _name_in(message, field.name), getattr(target, field.name)
        if name is not None:
            come = getattr(message, name)
            setattr(target, field.name, _read(value, come) if is_dataclass(value) else come)
    return target


def _name_in(message: Any, name: str) -> str | None:
    """Return what ROS 1 calls a field; None if it has none."""
    return next((one for one in (name, name.upper()) if hasattr(message, one)), None)
