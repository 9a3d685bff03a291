"""Who is in a domain of ROS 2: nodes that begin together, and publishers that have ended."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from cyclonedds.builtin import BuiltinDataReader
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from crtk_partners import DOMAIN, ENVIRONMENT, until
from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.crtk.ros2 import BUFFER
from trocar.crtk.ros2_graph import Gid, NodeEntities, ParticipantEntities
from trocar.lab.topics import Topics

pytestmark = pytest.mark.realtime
LARGEST = Path("/proc/sys/net/core/rmem_max")
PUBLISHER = """
import sys
from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.lab.topics import Topics
out = open_bus(Topics(domain=int(sys.argv[1]))).publisher("/ended/measured_js", JointState)
sys.stdin.read()
"""


def test_nodes_that_tell_their_names_together_are_all_known():
    graph = open_bus(Topics(domain=DOMAIN))._graph
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal)
    participant = DomainParticipant(DOMAIN)
    writer = DataWriter(participant, Topic(participant, "ros_discovery_info", ParticipantEntities), qos=quality)
    until(writer.get_matched_subscriptions)
    for number, name in enumerate(("console", "stranger", "logger")):
        gid = Gid([number + 1] * 16)
        writer.write(ParticipantEntities(gid, [NodeEntities("/", name, [], [gid])]))
    time.sleep(0.5)  # all of them have come before anybody looks
    graph._clients()
    assert {"/console", "/stranger", "/logger"} <= set(graph._node_of.values())


def test_a_publisher_that_has_ended_is_not_there():
    bus = open_bus(Topics(domain=DOMAIN))

    def there():
        return [one for one in bus.endpoints() if one.topic == "/ended/measured_js" and one.publishes]

    words = [sys.executable, "-c", PUBLISHER, str(DOMAIN)]
    with subprocess.Popen(words, env=ENVIRONMENT, stdin=subprocess.PIPE) as process:
        until(there)
        process.stdin.close()
    until(lambda: not there())


def test_what_was_told_once_is_not_read_again_however_often_senders_are_looked_up(monkeypatch):
    """A server looks up each new sender for seconds; to read a large domain each time held up its arms."""
    bus, read = open_bus(Topics(domain=DOMAIN)), []
    out, here = bus.publisher("/told/measured_js", JointState), bus.subscriber("/told/measured_js", JointState)
    until(lambda: out.send(JointState()) or here.take())
    (sender,) = here.sent_by
    known = bus.client(sender)
    assert known.process == str(os.getpid())
    for reads in ("read", "take"):
        inner = getattr(BuiltinDataReader, reads)

        def counted(self, N=1, condition=None, inner=inner):
            samples = inner(self, N, condition)
            read.extend(samples)
            return samples

        monkeypatch.setattr(BuiltinDataReader, reads, counted)
    for _ in range(10):
        assert bus.client(sender) == known
    assert len(read) < 10, "not even one each time"
    out = bus.publisher("/told/setpoint_js", JointState)
    assert "/told/setpoint_js" in {one.topic for one in bus.endpoints()}
    assert read and out.readers() == 0


def test_a_process_whose_entities_cannot_be_deleted_ends():
    stuck = "from cyclonedds.core import Entity; import time; Entity._delete = lambda self, ref: time.sleep(1000)\n"
    words = [sys.executable, "-c", stuck + PUBLISHER, str(DOMAIN)]
    subprocess.run(words, env=ENVIRONMENT, stdin=subprocess.DEVNULL, timeout=60.0, check=True)


def test_readers_can_be_counted_while_others_come_and_go():
    bus, over = open_bus(Topics(domain=DOMAIN)), threading.Event()
    out, counts = bus.publisher("/counted/measured_js", JointState), set()

    def come_and_go():
        while not over.is_set():
            assert [bus.subscriber("/counted/measured_js", JointState) for _ in range(5)]

    thread, end_s = threading.Thread(target=come_and_go), time.monotonic() + 1.0
    thread.start()
    try:
        while time.monotonic() < end_s:
            counts.add(out.readers())
    finally:
        over.set()
        thread.join()
    assert len(counts) > 2


@pytest.mark.skipif(not LARGEST.is_file(), reason="it is not Linux")
def test_as_much_may_wait_to_be_read_as_the_system_permits():
    open_bus(Topics(domain=DOMAIN))
    sizes = []
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(number))) as one:
            if one.type == socket.SOCK_DGRAM and one.family == socket.AF_INET:
                sizes.append(one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF))
    assert sizes and min(sizes) >= min(BUFFER, int(LARGEST.read_text()))
