"""Viser servers, started and stopped without output on stdout."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import rich

from trocar.errors import InvalidInput, NotInstalled

if TYPE_CHECKING:
    from viser import ViserServer

LOCAL = "127.0.0.1"
"""Only programs on this machine can reach a server at this address."""


def open_server(port: int) -> ViserServer:
    """Return a server that only this machine can reach.

    Args:
        port: if it is taken, the next free one; 0: any free one.

    Raises:
        TrocarError: viser is not installed, or there is no such port.
    """
    if not 0 <= port <= 65535:
        raise InvalidInput("the port", f"is {port}", "give 1 to 65535, or 0 for any that is free")
    try:
        from viser import ViserServer  # an extra
    except ImportError:
        raise NotInstalled("3D in the browser", "viser", "view") from None
    _wake_in_the_loop_only()
    with _quiet(), _as_ours():
        return ViserServer(host=LOCAL, port=port, verbose=False)


LOOK = """<style>
canvas[data-engine] { background: linear-gradient(#eef0f3, #ced3d9); }
[data-mantine-color-scheme="dark"] canvas[data-engine] { background: linear-gradient(#5a626c, #353b43); }
</style><script>
window.__VISER_EMBED_CONFIG__ = { darkMode: matchMedia("(prefers-color-scheme: dark)").matches };
</script>"""
"""What is added to each page of viser's: a plain background of the scene, and light or dark as the browser prefers,
which viser reads from there once the page is loaded."""

PANEL_PX = 460
PHONE = """<style>@media (max-width: 36em) {
.mantine-Paper-root[style*="position: fixed"] { width: 100vw !important; max-height: 58% !important; }
.mantine-Paper-root[style*="position: fixed"] .mantine-ScrollArea-content > div { width: 100% !important; }
.mantine-Paper-root[style*="position: fixed"] .mantine-Button-root { height: 3em !important; }
#root > div > div > div:has(canvas) { flex: none !important; height: 42% !important; }
}</style>"""
"""On a telephone, viser's panel is as wide as the screen, below the scene, and its buttons are as high as a finger."""


def open_panel(server: ViserServer, title: str, notice: str) -> None:
    """Open the panel beside the scene, with a title and a first line."""
    gui = server.gui
    gui.configure_theme(show_logo=False, show_share_button=False)
    gui.set_panel_label(title)
    gui.main_panel.dock_right()
    gui.main_panel.set_width(PANEL_PX)
    gui.add_markdown(f"*{notice}*", order=0)
    gui.add_html(PHONE, order=0)


def close_server(server: ViserServer) -> None:
    """Stop a server; its thread has ended and its port is free afterwards."""
    with _quiet():
        server.stop()


_CONSOLE = threading.Lock()


OWN = re.compile(r"https?://(127\.0\.0\.1|localhost)(:\d+)?")
"""Origins of this machine's own pages, also if a forwarded port takes them to another machine."""


class LoopEvent(asyncio.Event):
    """An event that threads other than that of its event loop may set; there, this does nothing.

    Args:
        loop: the event loop.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._of = loop

    def set(self) -> None:
        """Wake those who wait, if called in the loop's thread."""
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            return
        if running is self._of:
            super().set()


@cache
def _wake_in_the_loop_only() -> None:
    """Have viser's threads wake its event loop safely, in all servers of this process.

    With each message, viser 1.1.1 both asks its loop to set an event, as it should, and sets it from the present
    thread. Doing that raises an error if the loop begins to wait at the same moment, which ended the page.
    """
    from viser.infra import _async_message_buffer, _infra

    class Buffer(_async_message_buffer.AsyncMessageBuffer):
        def __init__(self, event_loop: asyncio.AbstractEventLoop, *args: object, **how: object) -> None:
            super().__init__(event_loop, *args, **how)  # type: ignore[arg-type]
            self.message_event = LoopEvent(event_loop)

    _infra.AsyncMessageBuffer = Buffer  # pyright: ignore[reportPrivateImportUsage]


@contextmanager
def _as_ours() -> Iterator[None]:
    """Make servers opened in this context refuse web pages of other origins, and add ``LOOK`` to their own page.

    Web pages of other origins could otherwise press buttons. Programs that name no origin are not web pages, and are
    accepted. viser has no setting for either.
    """
    from websockets.asyncio import server  # viser's

    serve = server.serve

    def ours(*given: Any, process_request: Any, **how: Any) -> Any:
        return serve(*given, process_request=partial(_dressed, process_request), origins=[None, OWN], **how)

    server.serve = ours
    try:
        yield
    finally:
        server.serve = serve


def _dressed(answer: Any, connection: Any, request: Any) -> Any:
    """Return viser's answer to a request, a page with ``LOOK`` at its end."""
    if "Accept-Encoding" in request.headers:
        del request.headers["Accept-Encoding"]  # nothing can be added to a packed page; inside, it is packed anyway
    response = answer(connection, request)
    if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
        response.body += LOOK.encode()
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the console on which viser announces itself; other consoles and stdout stay as they are."""
    console = rich.get_console()
    with _CONSOLE:  # otherwise two threads would restore each other's silenced state
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before
