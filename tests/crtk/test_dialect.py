"""Names and types of the dialects, and a Raven's seven joints as six and an opening."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.bus import stamped
from trocar.crtk.dialect import (
    as_positions,
    jaw_in,
    jaw_topic,
    joint_names,
    joints_in,
    pose_kind,
    require_joints,
    state_kind,
)
from trocar.crtk.messages import JointState, OldOperatingState, OperatingState, PoseStamped, TransformStamped
from trocar.errors import InvalidInput
from trocar.lab.topics import Dialect

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
    names = joint_names(Dialect.DVRK)
    assert joints_in(Dialect.DVRK, JointState(stamped(), list(names[::-1]), Q[::-1])) == pytest.approx(Q)


def test_names_of_joints_are_those_of_the_dialect_in_the_controllers_order_or_the_arm_is_refused():
    names = joint_names(Dialect.DVRK)
    for said, sent in (([], names), ([f"outer_{name}" for name in names], names), (names[::-1], names[::-1])):
        assert require_joints(Dialect.DVRK, said, "arm 'a'") == sent
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
