"""The files of ROS 2 bags, read without the message definitions in them, which may be wrong or missing."""

from __future__ import annotations

import sqlite3
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Generator, Mapping
from contextlib import closing
from pathlib import Path
from shlex import quote
from typing import Any

from trocar.errors import BadFile, NotInstalled

try:
    from mcap.exceptions import McapError
    from mcap.reader import McapReader, NonSeekingReader, make_reader
    from mcap.records import Channel, Schema
    from mcap.summary import Summary
    from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
    from rosbags.rosbag2 import Reader
    from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos
    from rosbags.rosbag2.reader import DirectoryReader
except ImportError:
    raise NotInstalled("a bag", "rosbags and mcap", "bags") from None

PROFILE = "ros2"
"""Profile of an MCAP file with messages of ROS 2."""
MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""
NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
Raw = tuple[Connection, int, bytes]
"""A message as it was recorded: its connection, its time in ns since 1970, and its bytes."""


class Storage(ABC):
    """One file, as rosbags' readers use it; it is open only while something is read from it.

    Attributes:
        path: of the file.
        connections: its topics, each with the number of its messages.
        metadata: number of all messages, and when the first and the last were recorded.
    """

    def __init__(self, path: Any):
        self.path = Path(path)
        self.connections: list[Connection] = []
        self.metadata = _metadata(0, 0, 0)

    @abstractmethod
    def open(self) -> None:
        """Read the list of topics."""

    def close(self) -> None:
        """Forget the topics."""
        self.connections = []

    @abstractmethod
    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[Raw, None, None]:
        """Yield all messages of these connections in the order in which they were recorded."""

    def _add(self, number: int, topic: str, kind: str, count: int, encoding: str, qos: str) -> None:
        ext = ConnectionExtRosbag2(encoding, parse_qos(qos))
        self.connections.append(Connection(number, topic, kind, NO_DEFINITION, "", count, ext, self))


class Database(Storage):
    """An SQLite file."""

    def open(self) -> None:
        """Read the list of topics.

        Raises:
            BadFile: a write-ahead log beside the file has messages that were not moved into it.
        """
        self.path.open("rb").close()  # SQLite does not say why it cannot open a file
        beside = self.path.with_name(f"{self.path.name}-wal")
        if beside.exists() and beside.stat().st_size:
            problem = f"was not closed properly, and its last messages are only in {beside.name!r} beside it"
            remedy = f'on a copy of both, run: sqlite3 {quote(self.path.name)} "pragma wal_checkpoint(truncate)"'
            raise BadFile(self.path, problem, remedy, kind="bag")
        columns = {column[1] for column in self._rows("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        for row in self._rows(
            f"SELECT topics.id, name, type, count(messages.id), serialization_format, {qos} FROM topics "
            "LEFT JOIN messages ON topics.id = messages.topic_id GROUP BY topics.id ORDER BY topics.id"
        ):
            self._add(*row)
        ((count, first, last),) = self._rows("SELECT count(*), min(timestamp), max(timestamp) FROM messages")
        self.metadata = _metadata(count, first, last)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[Raw, None, None]:
        """Yield all messages of these connections in the order in which they were recorded."""
        known = {connection.id: connection for connection in connections}
        places = ",".join("?" * len(known))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places}) ORDER BY timestamp"
        for number, at_ns, data in self._rows(query, *known):
            yield known[number], at_ns, data

    def _rows(self, query: str, *values: int) -> Generator[tuple[Any, ...], None, None]:
        address = f"{self.path.absolute().as_uri()}?immutable=1"  # writes nothing, so it reads read-only disks
        with closing(sqlite3.connect(address, uri=True)) as database:
            yield from database.execute(query, values)


class Mcap(Storage):
    """An MCAP file, in which there may be channels that are not ROS 2's."""

    _indexed = False

    def open(self) -> None:
        """Read the list of topics.

        Raises:
            BadFile: its messages are not ROS 2's.
        """
        with self.path.open("rb") as file:
            file.seek(max(0, self.path.stat().st_size - len(MAGIC)))
            if file.read() != MAGIC:
                raise McapError("its end is missing")
            file.seek(0)
            reader = make_reader(file)
            _require_ros2(self.path, reader.get_header().profile)
            summary = reader.get_summary()
            if summary is None or summary.statistics is None or not _names_kinds(summary):
                self._scan(file)
                return
        statistics, self._indexed = summary.statistics, bool(summary.chunk_indexes)
        for number, channel in summary.channels.items():
            count = statistics.channel_message_counts.get(number, 0)
            self._add_channel(summary.schemas.get(channel.schema_id), channel, count)
        self.metadata = _metadata(statistics.message_count, statistics.message_start_time, statistics.message_end_time)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[Raw, None, None]:
        """Yield all messages of these connections in the order in which they were recorded.

        Without an index, it is the order in the file.
        """
        known = {connection.id: connection for connection in connections}
        with self.path.open("rb") as file:
            reader: McapReader = (make_reader if self._indexed else NonSeekingReader)(file, validate_crcs=True)
            topics = {connection.topic for connection in connections}
            for _, channel, message in reader.iter_messages(topics, log_time_order=self._indexed):
                if channel.id in known:
                    yield known[channel.id], message.log_time, message.data

    def _scan(self, file: Any) -> None:
        """Count all messages, for lack of a complete summary."""
        file.seek(0)
        channels: dict[int, tuple[Schema | None, Channel]] = {}
        counts: Counter[int] = Counter()
        first_ns, last_ns = 2**63, 0
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            channels[channel.id] = schema, channel
            counts[channel.id] += 1
            first_ns, last_ns = min(first_ns, message.log_time), max(last_ns, message.log_time)
        for number, (schema, channel) in channels.items():
            self._add_channel(schema, channel, counts[number])
        self.metadata = _metadata(counts.total(), first_ns, last_ns)

    def _add_channel(self, schema: Schema | None, channel: Channel, count: int) -> None:
        qos = channel.metadata.get("offered_qos_profiles", "")
        self._add(channel.id, channel.topic, schema.name if schema else "", count, channel.message_encoding, qos)


class Folder(DirectoryReader):
    """The folder of a ROS 2 bag."""

    STORAGE_PLUGINS: Mapping[str, Any] = {"mcap": Mcap, "sqlite3": Database}


class Ros2(Reader):
    """A ROS 2 bag: a folder, or a file alone."""

    STORAGE_PLUGINS: Mapping[str, Any] = {"dir": Folder, ".mcap": Mcap, ".db3": Database}


def _require_ros2(path: Path, profile: str) -> None:
    """Raise BadFile if the profile of an MCAP file is not ROS 2's."""
    if profile == PROFILE:
        return
    if profile == "ros1":
        remedy = "give the .bag from which it was made, or convert that with rosbags-convert"
        raise BadFile(path, "holds messages of ROS 1", remedy, kind="bag")
    profile = f"has the profile {profile!r}" if profile else "has no profile"
    remedy = "give one that ros2 bag record -s mcap wrote"
    raise BadFile(path, f"{profile}, where messages of ROS 2 have {PROFILE!r}", remedy, kind="bag")


def _names_kinds(summary: Summary) -> bool:
    """Return whether a summary lists channels, and the schemas of all of them that have one."""
    wanted = {channel.schema_id for channel in summary.channels.values()} - {0}
    return bool(summary.channels) and wanted <= summary.schemas.keys()


def _metadata(count: int, first_ns: int, last_ns: int) -> ReaderMetadata:
    """Return the metadata of messages; rosbags counts until just after the last one."""
    if not count:
        return ReaderMetadata(0, 2**63 - 1, 0, 0, None, None, None, None)
    return ReaderMetadata(last_ns - first_ns + 1, first_ns, last_ns + 1, count, None, None, None, None)
