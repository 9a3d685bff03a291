"""Names, types and loop settings of the dialects, and a Raven's seven joints as six and an opening."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.bus import stamped
from trocar.crtk.dialect import (
    RAVEN_TICK_S,
    as_positions,
    jaw_in,
    jaw_topic,
    joint_names,
    joints_in,
    loop_settings,
    pose_kind,
    require_joints,
    state_kind,
)
from trocar.crtk.messages import JointState, OldOperatingState, OperatingState, PoseStamped, TransformStamped
from trocar.errors import InvalidInput
from trocar.hardware.arm import LoopSettings
from trocar.lab.topics import Dialect, Topics

Q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


@pytest.mark.parametrize("dialect", list(Dialect))
def test_what_is_sent_is_what_is_read(dialect):
    message = JointState(stamped(), list(joint_names(dialect)), as_positions(dialect, Q, 0.8))
    assert joints_in(dialect, message) == pytest.approx(Q)


def test_a_ravens_jaws_have_a_joint_each():
    *_, first, second = as_positions(Dialect.RAVEN, Q, 0.8)
    assert first + second == pytest.approx(0.8) and (second - first) / 2 == pytest.approx(0.6)
    assert jaw_topic(Dialect.RAVEN, "/arm1") == "/grasp1" and jaw_topic(Dialect.DVRK, "/PSM1") == "/PSM1/jaw"


def test_joints_are_put_in_order_by_their_names():
    for before in ("", "outer_"):  # as before dVRK 2.3
        names = [f"{before}{name}" for name in joint_names(Dialect.DVRK)]
        assert joints_in(Dialect.DVRK, JointState(stamped(), names[::-1], Q[::-1])) == pytest.approx(Q)


def test_names_of_joints_are_those_of_the_dialect_in_the_controllers_order_or_the_arm_is_refused():
    names = joint_names(Dialect.DVRK)
    for sent in (names, names[::-1]):
        for before in ("", "outer_"):
            assert require_joints(Dialect.DVRK, [f"{before}{name}" for name in sent], "arm 'a'") == sent
    assert require_joints(Dialect.DVRK, [], "arm 'a'") == names
    raven = joint_names(Dialect.RAVEN)
    assert require_joints(Dialect.RAVEN, [f"gold_{name}" for name in raven], "arm 'a'") == raven
    for dialect, said in ((Dialect.DVRK, [f"joint_{k}" for k in range(6)]), (Dialect.RAVEN, raven[::-1])):
        with pytest.raises(InvalidInput, match=f"arm 'a' names its joints {said[0]}, {said[1]}"):
            require_joints(dialect, said, "arm 'a'")


def test_nothing_is_available_without_a_stamp_or_with_another_number_of_joints():
    assert np.isnan(joints_in(Dialect.DVRK, JointState(position=Q))).all()
    assert np.isnan(joints_in(Dialect.DVRK, JointState(stamped(), [], Q[:5]))).all()
    assert np.isnan(jaw_in(JointState(stamped())))


def test_older_dialects_have_older_messages():
    assert state_kind(Dialect.DVRK) is OperatingState and pose_kind(Dialect.DVRK) is PoseStamped
    for dialect in (Dialect.CRTK_1_0, Dialect.RAVEN):
        assert state_kind(dialect) is OldOperatingState and pose_kind(dialect) is TransformStamped


def test_whole_numbers_of_a_stations_file_are_floats_and_are_taken():
    assert loop_settings(Topics(loop={"max_late": 20.0, "lag_s": 0.2})) == LoopSettings(max_late=20, lag_s=0.2)
    assert loop_settings(Topics(dialect=Dialect.RAVEN)).tick_s == RAVEN_TICK_S


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("max_late", 2.5, "max_late of a hardware loop is 2.5; give a whole number"),
        ("max_late", float("inf"), "max_late of a hardware loop is inf; give a whole number"),
        ("lagg_s", 0.1, "'lagg_s' is unknown; did you mean 'lag_s'"),
    ],
)
def test_a_loop_setting_out_of_bounds_is_refused(name, value, says):
    with pytest.raises(InvalidInput, match=says):
        loop_settings(Topics(loop={name: value}))
