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
        ({"twists_rad": (0.0, 1.0, np.nan)}, "twists_rad of arm 'psm-classic' must be finite"),
        ({"offsets": (0.0, 1.0, 0.0, 0.0, np.inf, 0.0)}, "offsets of arm 'psm-classic' must be finite"),
        ({"wrist_length_m": -0.01}, "none may be below 0"),
        ({"safe_depth_m": "deep"}, "must be numbers"),
        ({"coupling": ((1.0,),)}, r"must have shape \(4, 4\)"),
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
    with pytest.raises(TrocarError, match="joint 'yaw' must be finite, got nan"):
        Joint("yaw", np.nan, 1.0, 1.0, 1.0)
    with pytest.raises(TrocarError, match="joint 'yaw' must be finite, got inf"):
        Joint("yaw", -1.0, 1.0, np.inf, 1.0)
    with pytest.raises(TrocarError, match="velocity of motion limits must be finite"):
        MotionLimits(np.full(6, np.inf), np.ones(6))
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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"shaft_radius_m": 0.0}, "shaft_radius_m of instrument .* is 0.0; give a length above 0"),
        ({"finger_width_m": np.nan}, "must be finite"),
        ({"tip_chamfer_m": 0.02}, "give a shorter one"),
    ],
)
def test_impossible_instruments_are_refused(change, says):
    with pytest.raises(TrocarError, match=says):
        replace(PSM_CLASSIC.instrument, **change)


def test_arms_and_instruments_say_what_they_are_in_a_line_and_their_ranges_in_a_table():
    assert repr(PSM_CLASSIC) == (
        "<ArmModel 'psm-classic': joints yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw; tip 9.5 mm beyond the "
        "jaws' axis>"
    )
    assert repr(PSM_CLASSIC.instrument).endswith("shaft 8 mm thick, fingers 10.2 mm long>")
    page = PSM_CLASSIC._repr_html_()
    assert "<td>insertion</td><td>0.0 mm</td><td>240.0 mm</td>" in page
    assert "<td>yaw</td><td>-91.0 deg</td><td>91.0 deg</td><td>90.0 deg/s</td>" in page
    assert "&lt;ArmModel" in page
