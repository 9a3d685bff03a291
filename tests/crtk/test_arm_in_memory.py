"""The connection of an arm on a bus within this process, whose controller is a few messages."""

import pickle
import time
from functools import partial

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.crtk import arm as arm_module
from trocar.crtk.arm import CrtkArm
from trocar.crtk.bus import stamped
from trocar.crtk.dialect import PSM_JOINTS
from trocar.crtk.messages import JointState, OperatingState
from trocar.errors import InvalidInput
from trocar.lab.topics import Topics

Q = np.array([0.1, 0.2, 0.15, 0.4, 0.5, 0.6])


@pytest.fixture
def bus(monkeypatch):
    bus = MemoryBus()
    monkeypatch.setattr(arm_module, "open_bus", lambda topics: bus)
    monkeypatch.setattr(arm_module, "LISTEN_S", 0.0)
    monkeypatch.setattr(arm_module, "CONNECT_S", 0.0)
    return bus


def connected(bus, names=PSM_JOINTS, positions=Q, jaws=True, state=("ENABLED", True, False)):
    """Return the connection of an arm whose controller has just published once."""
    said = {f"/PSM1/{what}": (names, positions) for what in ("measured_js", "setpoint_js")}
    said |= {f"/PSM1/jaw/{what}": (["jaw"], [0.3]) for what in ("measured_js", "setpoint_js") if jaws}
    for topic in ("/PSM1/servo_jp", "/PSM1/jaw/servo_jp"):
        bus.subscriber(topic, JointState)
    bus.publisher("/PSM1/operating_state", OperatingState, latched=True).send(OperatingState(stamped(), *state))
    for topic, (named, at) in said.items():  # latched, so that they are there when the arm looks
        bus.publisher(topic, JointState, latched=True).send(JointState(stamped(), list(named), list(at)))
    return CrtkArm("psm1", Topics())


def test_a_psm_without_an_instrument_is_told_to_have_none_although_its_jaws_publish_nothing(bus):
    names = [*PSM_JOINTS[:3], "disc_1", "disc_2", "disc_3", "disc_4"]
    for jaws in (False, True):
        with pytest.raises(InvalidInput, match="has no instrument; insert one, and wait until it is engaged"):
            connected(bus, names, [0.0] * 7, jaws)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (("DISABLED", True, False), "is DISABLED, homed; enable and home it at its console"),
        (("ENABLED", False, False), "is ENABLED, not homed; enable and home it at its console"),
        (("ENABLED", True, True), "is busy: a person or its controller moves it; let go of its clutch"),
    ],
)
def test_an_arm_that_is_not_enabled_homed_and_idle_is_not_connected(bus, state, said):
    with pytest.raises(InvalidInput, match=f"CRTK arm 'psm1' {said}"):
        connected(bus, state=state)


def test_jaws_that_publish_nothing_are_told_with_their_topics(bus):
    with pytest.raises(InvalidInput, match="publishes no /PSM1/jaw/measured_js and no /PSM1/jaw/setpoint_js within"):
        connected(bus, jaws=False)


def test_joints_named_as_before_dvrk_2_3_are_read_in_their_order(bus):
    arm = connected(bus, [f"outer_{name}" for name in reversed(PSM_JOINTS)], Q[::-1])
    assert np.array_equal(arm.commanded()[0], Q)


def test_the_joint_that_its_controller_holds_elsewhere_is_named_with_its_own_distance_and_unit(bus):
    arm = connected(bus)
    arm.commanded()
    arm._last = Q + [0.004, 0, 0.001, 0, 0, 0]  # only the insertion is beyond what a controller may be off
    arm._setpoint.at_s = arm._jaw_setpoint.at_s = time.monotonic() + 60.0
    assert "is off what was sent, insertion by 0.0010 m, the jaws by 0.0000 rad" in arm._unheard().detail


def test_loop_settings_of_the_station_are_checked_where_an_arm_is_connected(bus):
    with pytest.raises(InvalidInput, match=r"stale_s of a hardware loop is -1\.0; give a finite number above 0"):
        CrtkArm("psm1", Topics(loop={"stale_s": -1.0}))


def test_the_connection_can_be_given_to_the_loops_process():
    again = pickle.loads(pickle.dumps(partial(CrtkArm, topics=Topics(domain=7))))
    assert again.func is CrtkArm and again.keywords == {"topics": Topics(domain=7)}
