"""Who may command is told over the real bus by machine and by ROS node, whoever else sends at the same time."""

import sys
import time
from contextlib import ExitStack

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, ENVIRONMENT, LIMIT_S, environment_of, process, python_of
from trocar.crtk.access import AccessBus
from trocar.crtk.bus import open_bus
from trocar.crtk.messages import JointState
from trocar.lab.topics import Topics

pytestmark = pytest.mark.realtime
NAMELESS = """
import sys, time
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import JointState
from trocar.lab.topics import Topics
out = open_bus(Topics(domain=int(sys.argv[1]))).publisher(sys.argv[2], JointState)
while True:
    out.send(JointState(stamped(), [sys.argv[3]], [0.0]))
    time.sleep(0.02)
"""
NODE = """
import sys, time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
out = rclpy.create_node(sys.argv[3]).create_publisher(JointState, sys.argv[2], 10)
while True:
    out.publish(JointState(name=[sys.argv[3]]))
    time.sleep(0.02)
"""


class Robot:
    """Hears one topic through an access list."""

    def __init__(self, topic, allowed):
        self.events = []
        self.access = AccessBus(
            open_bus(Topics(domain=DOMAIN)), allowed, lambda _: "psm1", lambda name, **more: self.events.append(name)
        )
        self._source, self.heard = self.access.subscriber(topic, JointState), []

    def until(self, holds):
        end_s = time.monotonic() + LIMIT_S
        while not holds():
            assert time.monotonic() < end_s, f"heard {self.heard[-3:]}, refused {self.access.refused}"
            self.heard += [message.name[0] for message in self._source.take()]
            time.sleep(0.01)

    def refused(self, name=""):
        return sum(count for client, count in self.access.refused.items() if name in client)


def test_a_program_without_a_node_is_known_by_its_machine():
    admitted = {"localhost": True, "127.0.0.1": True, "*": True, "10.0.0.9": False, "/console": False}
    robots = {allowed: Robot("/nameless/move_jp", [allowed]) for allowed in admitted}
    with process([sys.executable, "-c", NAMELESS, str(DOMAIN), "/nameless/move_jp", "it"], ENVIRONMENT):
        for robot in robots.values():
            robot.until(lambda robot=robot: len(robot.heard) >= 5 or robot.refused() >= 5)
    assert {allowed: bool(robot.heard) for allowed, robot in robots.items()} == admitted
    assert {allowed: not robot.refused() for allowed, robot in robots.items()} == admitted
    assert all(robot.events == ([] if admitted[allowed] else ["refused"]) for allowed, robot in robots.items())


@pytest.mark.skipif(not python_of(2).exists(), reason="no rclpy: tools/ros2.sh makes .ros2")
def test_a_node_is_known_by_its_name_and_another_one_beside_it_is_refused():
    topic = "/named/move_jp"
    robot = Robot(topic, ["/console"])
    with ExitStack() as stack:
        for name in ("console", "stranger"):
            words = [str(python_of(2)), "-c", NODE, str(DOMAIN), topic, name]
            stack.enter_context(process(words, environment_of(2, DOMAIN)))
        robot.until(lambda: robot.heard.count("console") >= 5 and robot.refused("/stranger") >= 5)
    assert set(robot.heard) == {"console"}
    assert not robot.refused("/console"), "whose name is not known yet has none"
