"""The content of a page of ``write_replay``, read without a browser: messages as its player would apply them."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from numpy.typing import NDArray

BASE88 = "".join(chr(code) for code in range(0x21, 0x7F) if chr(code) not in "\"&<>'`")
"""viser/client/vite-plugin-compress-html.mts."""


@dataclass
class Recording:
    """The messages of a page.

    Attributes:
        duration_s: of the player's slider.
        messages: time in s and content, in order.
        buffers: arrays that messages name by number.
    """

    duration_s: float
    messages: list[tuple[float, dict[str, Any]]]
    buffers: list[bytes]

    @staticmethod
    def of(page: str) -> Recording:
        """Read what ``StateSerializer.serialize`` wrote: sizes, zstd, msgpack, arrays on multiples of eight bytes."""
        (encoded,) = re.findall(r'window\.__VISER_EMBED_DATA__="([^"]*)"', page)
        packed = base64.b64decode(encoded)
        size = int.from_bytes(packed[:8], "little")
        inner = zstandard.ZstdDecompressor().decompress(packed[8:], max_output_size=size)
        end = 8 + int.from_bytes(inner[:8], "little")
        head = msgspec.msgpack.decode(inner[8:end])
        assert head["viserVersion"] == viser.__version__
        buffers = []
        for length in head["binaryBufferLengths"]:
            end += -end % 8
            buffers.append(inner[end : end + length])
            end += length
        return Recording(head["durationSeconds"], [(at, message) for at, message in head["messages"]], buffers)

    @property
    def times_s(self) -> NDArray[np.float64]:
        """Return the times (k,) at which something changes."""
        return np.unique([at for at, _ in self.messages])

    def array(self, value: dict[str, Any]) -> NDArray:
        """Return an array that a message names."""
        return np.frombuffer(self.buffers[value["__binary_index"]], dtype=value["dtype"])

    def of_kind(self, *kinds: str) -> list[tuple[float, dict[str, Any]]]:
        """Return the messages of these types."""
        return [(at, message) for at, message in self.messages if message["type"] in kinds]


@dataclass
class Node:
    """One node of the scene."""

    props: dict[str, Any] = field(default_factory=dict)
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    visible: bool = True


class Player:
    """Plays a recording forward."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.nodes, self._next = recording, {}, 0

    def play_to(self, time_s: float) -> dict[str, Node]:
        """Apply all messages up to a time and return the scene."""
        messages = self.recording.messages
        while self._next < len(messages) and messages[self._next][0] <= time_s + 1e-9:
            self._apply(messages[self._next][1])
            self._next += 1
        return self.nodes

    def _apply(self, message: dict[str, Any]) -> None:
        name = message.get("name")
        match message["type"]:
            case "SetPositionMessage":
                self._node(name).position = message["position"]
            case "SetOrientationMessage":
                self._node(name).wxyz = message["wxyz"]
            case "SetSceneNodeVisibilityMessage":
                self._node(name).visible = message["visible"]
            case "SceneNodeUpdateMessage":
                self._node(name).props.update(message["updates"])
            case kind if name is not None and "props" in message:
                self.nodes[name] = Node(props={"type": kind, **message["props"]})

    def _node(self, name: str) -> Node:
        return self.nodes.setdefault(name, Node())


def read_replay_poses(path: Path) -> tuple[NDArray[np.float64], dict[str, tuple[NDArray, NDArray]]]:
    """Return the times (k,) of a page's frames, and of each body that moves positions (k, 3) and quaternions (k, 4)."""
    recording = Recording.of(path.read_text())
    moving = {m["name"] for at, m in recording.of_kind("SetPositionMessage", "SetOrientationMessage") if at > 0}
    bodies = sorted(name for name in moving if name.startswith("/bodies/"))
    player, times = Player(recording), recording.times_s
    where: dict[str, list] = {name: [] for name in bodies}
    for time_s in times:
        nodes = player.play_to(time_s)
        for name in bodies:
            where[name].append((nodes[name].position, nodes[name].wxyz))
    return times, {
        name.removeprefix("/bodies/"): (np.array([p for p, _ in track]), np.array([q for _, q in track]))
        for name, track in where.items()
    }


def client_code(page: str) -> str:
    """Return viser's own program, which the page carries packed."""
    (packed,) = re.findall(r'<script data-p="([^"]*)"', page)
    digit = {letter: number for number, letter in enumerate(BASE88)}
    out = bytearray()
    for start in range(0, len(packed), 5):
        group = packed[start : start + 5]
        value = 0
        for letter in group:
            value = value * 88 + digit[letter]
        out += value.to_bytes(len(group) - 1, "big")
    return zstandard.ZstdDecompressor().decompress(bytes(out), max_output_size=1 << 26).decode()
