"""A made-up browser: what happens on its page reaches viser's server, without a page."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from viser import _messages

NUMBER = 1
LIMIT_S = 30.0


class Visitor:
    """What somebody does on a page of this server.

    Attributes:
        camera: of the page: ``wxyz``.
    """

    def __init__(self, server: Any, camera: Any) -> None:
        self._server, self.camera = server, camera

    def choose(self, handle: Any, value: object) -> None:
        """Set the value of a menu or a slider."""
        self._happens(_messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}))

    def trigger(self, label: str) -> None:
        """Press the key of a command."""
        commands = self._server.gui._command_handle_from_uuid
        (number,) = [number for number, command in commands.items() if command.label == label]
        self._happens(_messages.CommandTriggerMessage(number))

    def drag(self, node: str, places_m: list[tuple[float, float, float]]) -> None:
        """Take the handle at a node, drag it to these places, and let go."""
        self._happens(_messages.TransformControlsDragStartMessage(node))
        for place_m in places_m:
            self._happens(_messages.TransformControlsUpdateMessage(node, (1.0, 0.0, 0.0, 0.0), place_m))
        self._happens(_messages.TransformControlsDragEndMessage(node))

    def _happens(self, message: Any) -> None:
        handled = self._server._websock_server._handle_incoming_message(NUMBER, message)
        asyncio.run_coroutine_threadsafe(handled, self._server.get_event_loop()).result(LIMIT_S)


@contextmanager
def visitor_of(server: Any) -> Iterator[Visitor]:
    """Yield the only visitor of a server."""
    camera = SimpleNamespace(wxyz=(1.0, 0.0, 0.0, 0.0))
    storage = SimpleNamespace(get_item=lambda key: None)
    page = SimpleNamespace(client_id=NUMBER, camera=camera, local_storage=storage)
    server._connected_clients[NUMBER] = page
    try:
        yield Visitor(server, camera)
    finally:
        del server._connected_clients[NUMBER]


@contextmanager
def busy(server: Any) -> Iterator[None]:
    """Keep all of viser's threads for callbacks busy; then have them do what has come meanwhile."""
    pool, free = server._thread_executor, threading.Event()
    for _ in range(pool._max_workers):
        pool.submit(free.wait, LIMIT_S)
    try:
        yield
    finally:
        free.set()
        pool.submit(lambda: None).result(LIMIT_S)
