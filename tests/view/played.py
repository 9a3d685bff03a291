"""The content of a page of ``write_replay``, read without a browser: messages as its player would apply them."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass, field
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from numpy.typing import NDArray


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
