"""Bags: ROS 1 bags, ROS 2 bags (a folder, or its .db3 alone) and MCAP files, read message by message."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from trocar.bags.storage import Ros2
from trocar.calibration.recording import BAG_METADATA, BAGS
from trocar.errors import BadFile, InvalidInput, MachineError, NotInstalled, TrocarError, UnknownName
from trocar.files.output import blame

try:
    from rosbags.interfaces import Connection, TopicInfo
    from rosbags.rosbag1 import Reader as Ros1
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise NotInstalled("a bag", "rosbags", "bags") from None

REMEDY = "give a .bag, an .mcap, or the folder of a ROS 2 bag or its .db3"
UNFINISHED = ".bag.active"
"""How the name of a ROS 1 bag ends while it is being recorded."""
REPAIRS = {".mcap": "mcap recover", ".bag": "rosbag reindex"}
"""Tools that mend files that were cut off, by suffix."""
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
"""ROS's own kinds of messages. Those that are read here are the same in all versions of ROS 1 and of ROS 2, so the
definitions in a bag, which may be missing or wrong, are not needed."""
PLAIN = "cdr"
"""How ROS 2 encodes messages."""
NS_PER_S = 1_000_000_000
Found = TypeVar("Found")


@dataclass(frozen=True)
class Topic:
    """What a bag holds of one topic."""

    name: str
    kind: str
    """Package and name of its messages, such as ``sensor_msgs/JointState``, with their encoding if it is not ROS's own,
    such as ``Pose (json)``; empty if there are several kinds."""
    messages: int


@dataclass(frozen=True, eq=False)
class Bag:
    """An open bag.

    Attributes:
        path: of its file or folder.
        ros: 1 or 2.
        topics: by name, in order.
        start_ns: when its first message was recorded, since 1970.
        duration_s: from there to the last one.
    """

    path: Path
    ros: int
    topics: dict[str, Topic]
    start_ns: int
    duration_s: float
    _reader: Ros1 | Ros2

    def topic(self, name: str, *kinds: str) -> Topic:
        """Return a topic of one of these kinds.

        Raises:
            InvalidInput: the bag has no such topic, nothing was recorded of it, or it is of another kind.
        """
        if name not in self.topics:
            raise UnknownName(f"topic of {str(self.path)!r}", name, self.topics)
        topic = self.topics[name]
        if not topic.messages:
            remedy = "check that somebody publishes it, and record again"
            raise InvalidInput(f"topic {name!r} of {str(self.path)!r}", "has no message", remedy)
        if topic.kind not in kinds:
            problem = f"holds {topic.kind or 'messages of several kinds'}"
            raise InvalidInput(f"topic {name!r} of {str(self.path)!r}", problem, f"name one of {' or '.join(kinds)}")
        return topic

    def of_kind(self, *kinds: str) -> list[Topic]:
        """Return the topics of these kinds of which something was recorded, in the order of their names."""
        return [topic for topic in self.topics.values() if topic.kind in kinds and topic.messages]

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield topic and message in the order in which they were recorded; fields are named as in ROS.

        Raises:
            InvalidInput: the messages of a topic are not of ROS's own kinds.
            BadFile: the bag is damaged.
            MachineError: the machine is in trouble.
        """
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        for connection in wanted:
            self._require_own_kind(connection)
        decode = STORES[1].deserialize_ros1 if self.ros == 1 else STORES[2].deserialize_cdr
        found = self._reader.messages(connections=wanted) if wanted else iter(())
        while (one := _read(self.path, lambda: next(found, None))) is not None:
            connection, _, raw = one
            yield connection.topic, _read(self.path, lambda c=connection, r=raw: decode(r, c.msgtype))

    def _require_own_kind(self, connection: Connection) -> None:
        kind, store = connection.msgtype, STORES[self.ros]
        item = f"topic {connection.topic!r} of {str(self.path)!r}"
        if kind not in store.fielddefs or _encoding(connection) != PLAIN:
            raise InvalidInput(item, f"holds {_kind(connection)}", "only ROS's own kinds of messages can be read")
        if self.ros == 1 and connection.digest not in ("", "*", store.generate_msgdef(kind)[1]):
            problem = f"holds {_kind(connection)} of another definition than ROS's own, by its MD5 {connection.digest}"
            raise InvalidInput(item, problem, "name another topic, or record messages of ROS's own")


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Yield a bag that is open within the block.

    Raises:
        BadFile: it does not exist, is no bag, is damaged, or holds no message.
        MachineError: the machine is in trouble.
    """
    path = Path(path)
    _require_bag(path)
    ros = 1 if path.is_file() and path.suffix == ".bag" else 2
    reader = Ros1(path) if ros == 1 else Ros2(path)
    _read(path, reader.open)
    try:
        if not reader.message_count:
            raise _bad(path, "holds no message", "record it again")
        topics = {name: _topic(name, info) for name, info in sorted(reader.topics.items())}
        yield Bag(path, ros, topics, reader.start_time, (reader.duration - 1) / NS_PER_S, reader)
    finally:
        reader.close()


def _require_bag(path: Path) -> None:
    """Raise BadFile if a path cannot be that of a bag."""
    if not path.exists():
        raise _bad(path, "does not exist")
    if path.is_dir() and not (path / BAG_METADATA).is_file():
        inside = sorted(file.name for file in path.iterdir() if file.suffix in BAGS)
        remedy = f"give a file in it, such as {inside[0]}" if inside else REMEDY
        raise _bad(path, f"is a folder without {BAG_METADATA}", remedy)
    if path.name.endswith(UNFINISHED):
        name = path.name.removesuffix(UNFINISHED)
        remedy = f"end its recording, or, if that was cut off, run rosbag reindex on a copy and rename it to {name}.bag"
        raise _bad(path, "was not closed", remedy)
    if path.is_file() and path.suffix not in BAGS:
        raise _bad(path, f"does not end in {', '.join(BAGS)}")


def _topic(name: str, info: TopicInfo) -> Topic:
    kinds = {_kind(connection) for connection in info.connections}
    return Topic(name, kinds.pop() if len(kinds) == 1 else "", info.msgcount)


def _kind(connection: Connection) -> str:
    kind, encoding = connection.msgtype.replace("/msg/", "/"), _encoding(connection)
    return kind if encoding == PLAIN else f"{kind} ({encoding})".strip()


def _encoding(connection: Connection) -> str:
    return getattr(connection.ext, "serialization_format", PLAIN)


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header in ns since 1970; 0 means that its data are not valid."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _read(path: Path, function: Callable[[], Found]) -> Found:
    """Return the result of a reader's function; its errors become BadFile, or MachineError for the machine's own."""
    try:
        return function()
    except TrocarError:
        raise
    except MemoryError:
        problem = f"bag {str(path)!r} needs more memory than there is"
        raise MachineError(f"{problem}; close other programs, or, if it is damaged, {_repair(path)}") from None
    except Exception as error:  # parsers of YAML, SQLite, zstd and more, of a file that may hold anything
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(cause, OSError) and cause.errno and blame(cause) is MachineError:
            trouble = f"bag {str(path)!r} cannot be read ({cause.strerror})"
            raise MachineError(f"{trouble}; see to the machine and give the same command again") from None
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise _bad(path, f"cannot be read ({why})", f"if it was cut off, {_repair(path)}") from None


def _repair(path: Path) -> str:
    """Return what to do with a bag that was cut off."""
    inside = {file.suffix for file in path.iterdir()} if path.is_dir() else {path.suffix}
    tool = next((tool for suffix, tool in REPAIRS.items() if suffix in inside), "ros2 bag reindex")
    return f"mend a copy with {tool}"


def _bad(path: Path, problem: str, remedy: str = REMEDY) -> BadFile:
    return BadFile(path, problem, remedy, kind="bag")
