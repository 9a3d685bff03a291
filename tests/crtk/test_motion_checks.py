"""What the doctor says of joints' names, from messages as an arm publishes them."""

from collections import defaultdict

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.bus import stamped
from trocar.crtk.dialect import PSM_JOINTS
from trocar.crtk.heard_arm import ArmHeard
from trocar.crtk.listening import Heard
from trocar.crtk.messages import JointState
from trocar.crtk.motion_checks import names
from trocar.lab import load_station
from trocar.lab.topics import Topics

STATION = load_station("peg-transfer")


def judged(joints):
    """Return what is found where an arm names its joints so."""
    messages = defaultdict(list)
    for what in ("measured_js", "setpoint_js"):
        messages[f"/PSM1/{what}"] = [(at_s, JointState(stamped(), joints, [0.1] * len(joints))) for at_s in (1.0, 1.01)]
    return names(ArmHeard("psm1", STATION, Topics(), Heard(messages, [])))


@pytest.mark.parametrize("before", ["", "outer_"])
def test_the_names_of_each_release_of_the_dvrk_are_as_they_should_be(before):
    found = judged([f"{before}{name}" for name in PSM_JOINTS])
    assert found.well and found.found == "as they should be"
    swapped = judged([f"{before}{name}" for name in reversed(PSM_JOINTS)])
    assert swapped.well and swapped.found == "in another order, told by their names"


def test_joints_of_another_robot_are_told():
    assert judged([f"joint_{k}" for k in range(6)]).well is False


def test_an_arm_without_an_instrument_needs_one_and_no_other_model():
    found = judged([*PSM_JOINTS[:3], "disc_1", "disc_2", "disc_3", "disc_4"])
    assert found.well is False and "no instrument" in found.found
    assert found.remedy == "insert one, and wait until it is engaged"
