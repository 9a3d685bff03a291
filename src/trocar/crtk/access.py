"""Access to a server's arms: refuse commands of clients that may not command, and note who commands."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from functools import cache
from typing import Any, TypeVar, Unpack

from trocar.crtk.bus import KEPT_UNREAD, Bus, Client, Endpoint, Keeping, Publisher, Subscriber
from trocar.lab.topics import LOOPBACK

ANYBODY = "*"
THIS_MACHINE = "localhost"
KNOWN_S = 5.0
"""ROS 2 tells the node of a new publisher within two seconds; later, it is no longer looked up."""
AGAIN_S = 0.1
"""Time between look-ups until then."""
TOGETHER_S = 1.0
"""Two clients that move an arm within this time do so at the same time."""
Message = TypeVar("Message")


def default_allowed(interface: str) -> tuple[str, ...]:
    """Return who may command if nobody is named: everybody on the loopback interface, nobody on another one."""
    return (ANYBODY,) if interface == LOOPBACK else ()


def admits(allowed: Sequence[str], client: Client) -> bool:
    """Return whether a list names a client, by its ROS node, its machine's address, ``localhost`` or ``*``."""
    if ANYBODY in allowed or client.node in allowed or any(address in allowed for address in client.addresses):
        return True
    return THIS_MACHINE in allowed and bool(client.addresses) and all(map(_is_here, client.addresses))


@cache
def _is_here(address: str) -> bool:
    """Return whether an address is one of this machine: only then can a socket be bound to it."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.bind((address, 0))
    except OSError:
        return False
    return True


class AccessBus:
    """A bus whose subscribers receive only the messages of clients that may command.

    Refused messages are counted, and noted as one event for each client and topic. Two clients that move an arm at the
    same time are noted as well, even if both may command.

    Args:
        bus: of the server.
        allowed: nodes (``/console``), addresses, ``localhost``, or ``*``.
        arm_of: returns the arm that a topic commands; None if it commands none, so that anybody may use it.
        note: notes an event, given its name and its fields.

    Attributes:
        refused: messages that were refused, by client.
    """

    def __init__(
        self, bus: Bus, allowed: Sequence[str], arm_of: Callable[[str], str | None], note: Callable[..., None]
    ):
        self._bus, self._allowed, self._arm_of, self._note = bus, tuple(allowed), arm_of, note
        self._clients: dict[Hashable, tuple[Client, float, float]] = {}
        self._moved: dict[str, dict[tuple[Any, ...], tuple[float, Client]]] = {}
        self._noted: set[tuple[Any, ...]] = set()
        self.refused: Counter[str] = Counter()

    def publisher(self, topic: str, kind: type[Message], **keeping: Unpack[Keeping]) -> Publisher[Message]:
        """Return a publisher of a topic."""
        return self._bus.publisher(topic, kind, **keeping)

    def subscriber(
        self, topic: str, kind: type[Message], *, latched: bool = False, kept: int = KEPT_UNREAD
    ) -> Subscriber[Message]:
        """Return a subscriber of a topic that receives only messages of clients that may command."""
        inner, arm = self._bus.subscriber(topic, kind, latched=latched, kept=kept), self._arm_of(topic)
        return inner if arm is None else _Admitting(inner, self, arm, topic)

    def endpoints(self) -> list[Endpoint]:
        """Return all publishers and subscribers."""
        return self._bus.endpoints()

    def client(self, sender: Hashable) -> Client:
        """Return who a sender is; a client that has left is remembered."""
        now_s = time.monotonic()
        client, since_s, again_s = self._clients.get(sender, (Client(), now_s, now_s))
        if not client.node and again_s <= now_s <= since_s + KNOWN_S:
            found = self._bus.client(sender)
            client = client if found == Client() else found
            self._clients[sender] = client, since_s, now_s + AGAIN_S
        return client

    def hears(self, sender: Hashable, arm: str, topic: str) -> bool:
        """Return whether a message is accepted; note refused clients, and clients that move one arm together."""
        client = self.client(sender)
        if not admits(self._allowed, client):
            self.refused[str(client)] += 1
            reason = "is not among those who may command; --allow names them"
            self._once("refused", arm=arm, topic=topic, client=str(client), reason=reason)
            return False
        if topic.rpartition("/")[2].startswith(("servo_", "move_")):
            self._moves(client, arm)
        return True

    def _moves(self, client: Client, arm: str) -> None:
        """Note clients that move an arm at the same time."""
        moved = self._moved.setdefault(arm, {})
        moved[client.addresses, client.process or client.node] = time.monotonic(), client  # node may be unknown yet
        if len(moved) > 1 and len(together := self.movers(arm)) > 1:
            self._once("two clients", arm=arm, clients=together)

    def movers(self, arm: str) -> list[str]:
        """Return who has just moved an arm."""
        now_s = time.monotonic()
        return sorted(str(one) for at_s, one in self._moved.get(arm, {}).values() if now_s - at_s < TOGETHER_S)

    def _once(self, name: str, **values: Any) -> None:
        key = (name, *map(str, values.values()))
        if key not in self._noted:
            self._noted.add(key)
            self._note(name, **values)


class _Admitting(Subscriber[Message]):
    def __init__(self, inner: Subscriber[Message], access: AccessBus, arm: str, topic: str):
        super().__init__()
        self._inner, self._access, self._arm, self._topic = inner, access, arm, topic

    def senders(self) -> int:
        return self._inner.senders()

    def _come(self) -> list[tuple[float, Hashable, Message]]:
        come = self._inner._come()
        return [one for one in come if self._access.hears(one[1], self._arm, self._topic)]
