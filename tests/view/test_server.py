"""Who may open a page's socket, and how a page is woken from other threads."""

import asyncio
import urllib.request

import pytest

pytest.importorskip("viser")
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from trocar.view.server import LOOK, LoopEvent, close_server, open_server


@pytest.fixture(scope="module")
def server():
    server = open_server(0)
    yield server
    close_server(server)


def opened(server, origin):
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    address = f"ws://127.0.0.1:{server.get_port()}"
    return connect(address, subprotocols=[protocol], origin=origin, max_size=None, proxy=None)


@pytest.mark.parametrize("origin", [None, "http://127.0.0.1:8080", "http://localhost:9000", "https://localhost"])
def test_pages_of_this_machine_and_programs_may(server, origin):
    with opened(server, origin) as socket:
        assert socket.recv(timeout=20)


@pytest.mark.parametrize(
    "origin", ["https://example.com", "http://localhost.example.com", "http://127.0.0.1.example.com:8080", "null"]
)
def test_a_website_may_not(server, origin):
    """A browser lets every website open a socket to any port of this machine, and says whose it is."""
    with pytest.raises(InvalidStatus, match="403"):
        opened(server, origin)


def test_its_page_is_viser_s_with_our_look_whether_or_not_a_browser_would_take_it_packed(server):
    for packed in ({}, {"Accept-Encoding": "gzip"}):
        request = urllib.request.Request(f"http://127.0.0.1:{server.get_port()}/?darkMode", headers=packed)
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=20) as answer:
            page = answer.read().decode()
        assert page.endswith(f"</html>\n{LOOK}") and page.count(LOOK) == 1


def test_another_thread_wakes_nobody_by_itself():
    """asyncio's own event runs through its list of waiting tasks there, while the loop may be adding to it."""

    async def woken():
        event = LoopEvent(asyncio.get_running_loop())
        waiter = asyncio.create_task(event.wait())
        await asyncio.to_thread(event.set)
        await asyncio.sleep(0.01)
        before = event.is_set(), waiter.done()
        await asyncio.to_thread(asyncio.get_running_loop().call_soon_threadsafe, event.set)
        await asyncio.wait_for(waiter, 20)
        return before

    assert asyncio.run(woken()) == (False, False)


def test_a_page_and_its_clients_are_woken_so(server):
    of_all = server._websock_server
    with opened(server, None) as socket:
        socket.recv(timeout=20)
        (client,) = of_all._client_state_from_id.values()
        events = [buffer.message_event for buffer in (of_all.get_message_buffer(), client.message_buffer)]
        assert [type(event) for event in events] == [LoopEvent, LoopEvent]
