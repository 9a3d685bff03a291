"""The real rospy of ROS 1 reads and commands a served arm, on every topic and in both directions."""

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import python_of, ros1_master
from crtk_topics import check_commands, check_reports, exchange

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(not python_of(1).exists(), reason="no rospy: tools/ros1.sh makes .ros1 with Debian's packages"),
]


def test_rospy_reads_and_commands_every_topic_of_an_arm():
    with ros1_master() as master:
        partner, cell = exchange(1, domain=0, master=master)
    check_reports(partner)
    check_commands(partner, cell)
