from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS, PSM_CLASSIC, Joint, MotionLimits, fk
from trocar.errors import TrocarError


@pytest.mark.parametrize(("name", "arm"), ARMS.items())
def test_every_arm_is_registered_under_its_name_and_has_one_branch(name, arm):
    assert arm.name == name
    assert arm.branch_is_unique
    assert [joint.unit for joint in arm.joints] == ["rad", "rad", "m", "rad", "rad", "rad"]
    assert hash(arm) == hash(replace(arm))


def test_the_motion_limits_are_those_of_the_paper_and_of_dvrk():
    paper, dvrk = MOTION_LIMITS["paper"], MOTION_LIMITS["dvrk"]
    np.testing.assert_allclose(paper.velocity / np.pi, [2, 2, 0.4 / np.pi, 12, 12, 12])
    np.testing.assert_allclose(paper.acceleration / np.pi, [2, 2, 0.4 / np.pi, 8, 8, 8])
    np.testing.assert_allclose(np.degrees(dvrk.velocity)[[0, 1, 3, 4, 5]], [90, 90, 1080, 1080, 1080])
    np.testing.assert_allclose(np.degrees(dvrk.acceleration)[[0, 1, 3, 4, 5]], [90, 90, 720, 720, 720])
    assert dvrk.velocity[2] == dvrk.acceleration[2] == 0.2


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"joints": PSM_CLASSIC.joints[:5]}, "6 joints"),
        ({"joints": PSM_CLASSIC.joints[::-1]}, "prismatic"),
        ({"wrist_sign": 0}, "wrist_sign"),
        ({"twists_rad": (0.0, 0.0, 1.0)}, "parallel"),
    ],
)
def test_impossible_arms_are_refused(change, says):
    with pytest.raises(TrocarError, match=says):
        replace(PSM_CLASSIC, **change)


def test_impossible_joints_and_limits_are_refused():
    with pytest.raises(TrocarError, match="'yaw'"):
        Joint("yaw", 1.0, -1.0, 1.0, 1.0)
    with pytest.raises(TrocarError, match="'yaw'"):
        Joint("yaw", -1.0, 1.0, 0.0, 1.0)
    with pytest.raises(TrocarError, match="above 0"):
        MotionLimits(np.zeros(6), np.ones(6))
    with pytest.raises(TrocarError, match="shapes"):
        MotionLimits(np.ones(6), np.ones(5))


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_a_widened_arm_goes_further_at_both_ends_and_is_the_same_otherwise(arm):
    wide = arm.widened(0.2, 0.03)
    more = np.array([0.2, 0.2, 0.03, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(wide.lower, arm.lower - more)
    np.testing.assert_allclose(wide.upper, arm.upper + more)
    np.testing.assert_array_equal(fk(wide, arm.middle).matrix, fk(arm, arm.middle).matrix)
