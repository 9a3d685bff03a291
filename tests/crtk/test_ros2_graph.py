"""Who is in a domain of ROS 2: nodes that begin together, and publishers that have ended."""

import os
import subprocess
import sys
import threading
import time

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.crtk.ros2_graph import Gid, NodeEntities, ParticipantEntities
from trocar.lab.topics import Topics

pytestmark = pytest.mark.realtime
DOMAIN = 40 + os.getpid() % 150
LIMIT_S = 20.0
PUBLISHER = """
import sys
from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.lab.topics import Topics
out = open_bus(Topics(domain=int(sys.argv[1]))).publisher("/ended/measured_js", JointState)
sys.stdin.read()
"""


def until(holds):
    end_s = time.monotonic() + LIMIT_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.02)


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

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-c", PUBLISHER, str(DOMAIN)]
    with subprocess.Popen(words, env=environment, stdin=subprocess.PIPE) as process:
        until(there)
        process.stdin.close()
    until(lambda: not there())


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
