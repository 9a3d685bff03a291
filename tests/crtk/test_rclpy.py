"""The real rclpy of ROS 2 reads and commands a served arm, on every topic and in both directions."""

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, python_of
from crtk_topics import check_commands, check_reports, exchange

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(
        not python_of(2).exists(), reason="no rclpy: tools/ros2.sh makes .ros2 with ROS 2 Kilted's wheels"
    ),
]


def test_rclpy_reads_and_commands_every_topic_of_an_arm():
    partner, cell = exchange(2, domain=DOMAIN, master="")
    check_reports(partner)
    check_commands(partner, cell)
