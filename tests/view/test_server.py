"""Who may open a page's socket."""

import pytest

pytest.importorskip("viser")
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from trocar.view.server import close_server, open_server


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
