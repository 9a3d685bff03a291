"""A ROS 1 master that ends while a program listens: rospy and its packages are stood in for, the network is not."""

import importlib
import os
import socket
import sys
import threading
import xmlrpc.client
from contextlib import suppress
from types import SimpleNamespace

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.bus import Client
from trocar.errors import InvalidInput
from trocar.lab.topics import Topics


class MasterException(Exception):
    """As of rosgraph."""


class Master:
    """As of rosgraph, which calls the master by XML-RPC and lets pass what that raises."""

    address = ""

    def __init__(self, caller):
        self._asked = xmlrpc.client.ServerProxy(self.address)

    def getSystemState(self):
        return self._asked.getSystemState("/trocar")

    def lookupNode(self, node):
        return self._asked.lookupNode("/trocar", node)


@pytest.fixture
def ros1(monkeypatch):
    """The module, with a bus whose master answered once."""
    graph = SimpleNamespace(Master=Master, MasterException=MasterException, is_master_online=lambda: True)
    stand_ins = {
        "rosgraph": graph,
        "rospy": SimpleNamespace(init_node=lambda *_, **__: None),
        "genpy": SimpleNamespace(),
        "genpy.dynamic": SimpleNamespace(generate_dynamic=None),
    }
    for name, module in stand_ins.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr("os.environ", dict(os.environ))
    monkeypatch.delitem(sys.modules, "trocar.crtk.ros1", raising=False)
    module = importlib.import_module("trocar.crtk.ros1")
    module.really_reached = module._is_reached
    monkeypatch.setattr(module, "_is_reached", lambda master: True)
    yield module
    sys.modules.pop("trocar.crtk.ros1", None)


@pytest.fixture(params=["ended", "hangs up", "speaks no HTTP", "speaks no XML-RPC"])
def master(request, monkeypatch):
    """The address of a master that has ended, or of what is there instead."""
    said = {"hangs up": b"", "speaks no HTTP": b"what?\r\n\r\n"}
    page = b"HTTP/1.0 404 Not Found\r\nContent-Length: 0\r\n\r\n"
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"http://127.0.0.1:{server.getsockname()[1]}"

        def answer():
            with suppress(OSError):
                while True:
                    with server.accept()[0] as link:
                        link.recv(1 << 16)
                        link.sendall(said.get(request.param, page))

        if request.param == "ended":
            server.close()
        else:
            threading.Thread(target=answer, daemon=True).start()
        monkeypatch.setattr(Master, "address", address)
        yield address


def test_a_master_that_has_ended_is_a_sentence_where_all_endpoints_are_wanted(ros1, master):
    bus = ros1.Ros1Bus(Topics(ros=1, master=master))
    with pytest.raises(InvalidInput, match=f"the ROS 1 master at {master} does not answer any more; start roscore"):
        bus.endpoints()


def test_a_sender_whom_nobody_can_tell_has_no_address(ros1, master):
    assert ros1.Ros1Bus(Topics(ros=1, master=master)).client("/console") == Client("/console")


@pytest.mark.parametrize("master", ["http://192.0.2.1:11311", "http://here:port"])
def test_a_master_whose_machine_accepts_no_connection_is_not_waited_for(ros1, master, monkeypatch):
    def no_answer(address, timeout_s):
        assert address == ("192.0.2.1", 11311) and timeout_s < 10.0
        raise TimeoutError

    monkeypatch.setattr(ros1, "_is_reached", ros1.really_reached)
    monkeypatch.setattr(socket, "create_connection", no_answer)
    with pytest.raises(InvalidInput, match=f"the ROS 1 master at {master} does not answer; start roscore, or name"):
        ros1.Ros1Bus(Topics(ros=1, master=master))
