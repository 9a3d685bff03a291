"""Bags: ROS 1 bags, ROS 2 bags (a folder, or its .db3 alone) and MCAP files, read message by message."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from trocar.calibration.recording import BAG_METADATA, BAGS
from trocar.errors import BadFile, InvalidInput, NotInstalled, UnknownName

try:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise NotInstalled("a bag", "rosbags", "bags") from None

REMEDY = "give a .bag, an .mcap, or the folder of a ROS 2 bag, closed properly (rosbag reindex, ros2 bag reindex)"
NS_PER_S = 1_000_000_000
Found = TypeVar("Found")


@dataclass(frozen=True)
class Topic:
    """What a bag holds of one topic."""

    name: str
    kind: str
    """Package and name of its messages, ``sensor_msgs/JointState``; empty if there are several kinds."""
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
    _reader: AnyReader

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
        """Yield topic and message in the order in which they were recorded; fields are named as in ROS 2.

        Raises:
            BadFile: the bag is damaged.
        """
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        found = self._reader.messages(connections=wanted) if wanted else iter(())
        while (one := _read(self.path, lambda: next(found, None))) is not None:
            connection, _, raw = one
            yield connection.topic, _read(self.path, lambda c=connection, r=raw: self._reader.deserialize(r, c.msgtype))


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Yield a bag that is open within the block.

    Raises:
        BadFile: it does not exist, is no bag, is damaged, or holds no message.
    """
    path = Path(path)
    if not path.exists():
        raise _bad(path, "does not exist")
    if path.is_dir() and not (path / BAG_METADATA).is_file():
        inside = sorted(file.name for file in path.iterdir() if file.suffix in BAGS)
        remedy = f"give a file in it, such as {inside[0]}" if inside else REMEDY
        raise _bad(path, f"is a folder without {BAG_METADATA}", remedy)
    if path.is_file() and path.suffix not in BAGS:
        raise _bad(path, f"does not end in {', '.join(BAGS)}")
    # bags of before ROS 2 Iron do not say what their messages consist of; those read here are the same in all versions
    store = get_typestore(Stores.ROS2_HUMBLE)
    reader = _read(path, lambda: AnyReader([path], default_typestore=store))
    _read(path, reader.open)
    try:
        if not reader.message_count:
            raise _bad(path, "holds no message", "record it again")
        topics = {
            name: Topic(name, (info.msgtype or "").replace("/msg/", "/"), info.msgcount)
            for name, info in sorted(reader.topics.items())
        }
        yield Bag(path, 2 if reader.is2 else 1, topics, reader.start_time, (reader.duration - 1) / NS_PER_S, reader)
    finally:
        reader.close()


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header in ns since 1970; 0 means that its data are not valid."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _read(path: Path, function: Callable[[], Found]) -> Found:
    """Return what a function of the reader returns; whatever it raises says that the file is damaged or no bag."""
    try:
        return function()
    except Exception as error:  # parsers of YAML, SQLite, zstd and more, of a file that may hold anything
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise _bad(path, f"cannot be read ({why})") from None


def _bad(path: Path, problem: str, remedy: str = REMEDY) -> BadFile:
    return BadFile(path, problem, remedy, kind="bag")
