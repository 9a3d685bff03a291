"""MCAP files of ROS 2 messages."""

from __future__ import annotations

from typing import IO, Any

from trocar.bags.reader import NS_PER_S
from trocar.errors import NotInstalled

try:
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise NotInstalled("an MCAP file", "mcap and rosbags", "bags") from None

_STORE = get_typestore(Stores.ROS2_JAZZY)


def kind(package: str, name: str) -> Any:
    """Return the class of a message of ROS 2 Jazzy, whose arguments are the message's fields."""
    return _STORE.types[f"{package}/msg/{name}"]


TIME, DURATION = kind("builtin_interfaces", "Time"), kind("builtin_interfaces", "Duration")
HEADER = kind("std_msgs", "Header")


def stamped(stamp_ns: int, frame: str = "") -> Any:
    """Return a header."""
    return HEADER(stamp(stamp_ns), frame)


def stamp(stamp_ns: int) -> Any:
    """Return a time."""
    return TIME(stamp_ns // NS_PER_S, stamp_ns % NS_PER_S)


class McapFile:
    """Writes messages and their definitions to an MCAP file, in ROS 2's encoding.

    Args:
        file: open for writing.
        made_by: becomes the file's ``library``.
    """

    def __init__(self, file: IO[bytes], made_by: str):
        self._writer = Writer(file)
        self._writer.start("ros2", made_by)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Write a message, with its stamp as the time of recording; each topic has messages of one kind."""
        name = message.__msgtype__
        if topic not in self._channels:
            if name not in self._schemas:
                text, _ = _STORE.generate_msgdef(name, ros_version=2)
                self._schemas[name] = self._writer.register_schema(name, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[name])
        data = bytes(_STORE.serialize_cdr(message, name))
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns)

    def close(self) -> None:
        """Write the file's end."""
        self._writer.finish()
