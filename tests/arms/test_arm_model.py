from dataclasses import replace

import numpy as np
import pytest

from recounted import SHIFT, recounted
from trocar.arms import ARMS, PSM_CLASSIC, Joint, MotionLimits, fk, ik
from trocar.errors import TrocarError


@pytest.mark.parametrize(("name", "arm"), ARMS.items())
def test_every_arm_is_registered_under_its_name_and_has_one_branch(name, arm):
    assert arm.name == name
    assert arm.branch_is_unique
    assert [joint.unit for joint in arm.joints] == ["rad", "rad", "m", "rad", "rad", "rad"]
    assert hash(arm) == hash(replace(arm))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"joints": PSM_CLASSIC.joints[:5]}, "6 joints"),
        ({"joints": PSM_CLASSIC.joints[::-1]}, "prismatic"),
        ({"wrist_sign": 0}, "wrist_sign"),
        ({"twists_rad": (0.0, 0.0, 1.0)}, "parallel"),
        ({"twists_rad": (0.0, 1.0, np.nan)}, "twists_rad of arm 'psm-classic' must be finite"),
        ({"twists_rad": (0.0, 1e-3, 0.5e-3)}, "parallel"),
        ({"twists_rad": (0.0, np.pi, 1.0)}, "parallel"),
        ({"offsets": (0.0, 1.0, 0.0, 0.0, np.inf, 0.0)}, "offsets of arm 'psm-classic' must be finite"),
        ({"offsets": PSM_CLASSIC.offsets[:5]}, "got 6 and 5"),
        ({"wrist_length_m": -0.01}, "none may be below 0"),
        ({"tip_length_m": -0.01}, "none may be below 0"),
        ({"safe_depth_m": -0.01}, "none may be below 0"),
        ({"joints": (*PSM_CLASSIC.joints[:5], replace(PSM_CLASSIC.joints[5], prismatic=True))}, "prismatic"),
        ({"safe_depth_m": "deep"}, "must be numbers"),
        ({"coupling": ((1.0,),)}, r"must have shape \(4, 4\)"),
    ],
)
def test_impossible_arms_are_refused(change, says):
    with pytest.raises(TrocarError, match=says):
        replace(PSM_CLASSIC, **change)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ((1.0, -1.0, 1.0, 1.0), "'yaw'"),
        ((1.0, 1.0, 1.0, 1.0), "give lower < upper"),
        ((-1.0, 1.0, 0.0, 1.0), "'yaw'"),
        ((-1.0, 1.0, 1.0, 0.0), "both must be above 0"),
        ((np.nan, 1.0, 1.0, 1.0), "joint 'yaw' must be finite, got nan"),
        ((-1.0, 1.0, np.inf, 1.0), "joint 'yaw' must be finite, got inf"),
    ],
)
def test_impossible_joints_are_refused(values, says):
    with pytest.raises(TrocarError, match=says):
        Joint("yaw", *values)


@pytest.mark.parametrize(
    ("bounds", "says"),
    [
        ((np.full(6, np.inf), np.ones(6)), "velocity of motion limits must be finite"),
        ((np.zeros(6), np.ones(6)), "above 0"),
        ((np.ones(6), np.ones(5)), "shapes"),
        ((np.ones(6), np.ones(6), np.ones(5)), "shapes"),
        ((np.ones((2, 6)), np.ones((2, 6))), "shapes"),
        ((np.ones(6), np.ones(6), np.array([1.0, 0.0]).repeat(3)), "above 0, got jerk"),
    ],
)
def test_impossible_motion_limits_are_refused(bounds, says):
    with pytest.raises(TrocarError, match=says):
        MotionLimits(*bounds)
    assert MotionLimits([1, 2], [3, 4], [5, 6]).jerk.tolist() == [5, 6]


def test_a_share_of_limits_is_one_of_each_and_slower_ones_are_those_of_the_same_path_later():
    whole = MotionLimits([1, 2], [3, 4], [5, 6])
    half, later = whole.scaled(0.5), whole.slowed(0.5)
    assert [x.tolist() for x in (half.velocity, half.acceleration, half.jerk)] == [[0.5, 1], [1.5, 2], [2.5, 3]]
    assert [x.tolist() for x in (later.velocity, later.acceleration, later.jerk)] == [
        [0.5, 1],
        [0.75, 1],
        [0.625, 0.75],
    ]
    assert whole.scaled(1.0) is whole and whole.slowed(1.0) is whole
    assert MotionLimits([1, 2], [3, 4]).scaled(0.5).jerk is None


def test_nearly_parallel_axes_and_a_tip_on_the_jaws_axis_are_possible():
    assert replace(PSM_CLASSIC, twists_rad=(0.0, 1e-3, 1.5e-3), tip_length_m=0.0).twists_rad[1] == 1e-3
    with pytest.raises(TrocarError, match="shape"):
        PSM_CLASSIC.configurations(np.zeros((2, 5)))


def test_a_joint_knows_its_middle_and_shows_itself_in_its_own_unit():
    yaw, slide = Joint("yaw", -1.0, 2.0, 3.0, 4.0), Joint("slide", 0.1, 0.2, 3.0, 4.0, prismatic=True)
    assert (yaw.middle, yaw.unit, slide.unit) == (0.5, "rad", "m")
    assert (yaw.shown(np.pi / 2), slide.shown(0.0123), slide.shown_scale) == ("90.0 deg", "12.3 mm", (1000.0, "mm"))


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_what_belongs_to_every_joint_is_in_their_order_and_cannot_be_overwritten(arm):
    for values in (arm.lower, arm.upper, arm.middle, arm.turns):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0
    np.testing.assert_allclose(arm.middle, (arm.lower + arm.upper) / 2)
    assert arm.middle_floats == arm.middle.tolist()
    assert arm.ranges == tuple((joint.lower, joint.upper) for joint in arm.joints)
    np.testing.assert_allclose(arm.turns / (2 * np.pi), [1, 1, 0, 1, 1, 1])
    assert arm.motion_limits.acceleration[0] == arm.joints[0].max_acceleration


def test_right_angles_have_exact_sines_and_cosines():
    """So that a PSM's axes meet at right angles to the last bit."""
    assert PSM_CLASSIC.twist_cosines == ((0, 1), (0, -1), (0, 1))
    assert replace(PSM_CLASSIC, twists_rad=(1e-9, 0.5, 1.0)).twist_cosines[0] == (1.0, 1e-9)


def test_a_joint_that_turns_further_than_once_leaves_a_choice_of_turns():
    """Up to 80 deg from its middle both turns of the roll are within 260 deg; the yaw never has two."""
    (yaw, *yaw_span), (roll, *roll_span) = PSM_CLASSIC.turn_targets
    assert (yaw, roll) == (0, 3)
    np.testing.assert_allclose(yaw_span, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.degrees(roll_span), [-80, 80])
    moved = recounted(PSM_CLASSIC).turn_targets
    np.testing.assert_allclose(moved[1][1:], np.array(roll_span) - SHIFT[3])
    np.testing.assert_allclose(moved[0][1:], -SHIFT[0])


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
@pytest.mark.parametrize(
    "shift", [SHIFT, [2.0, -2.2, 0.05, 2.5, 2.0, -2.1], [-2.0, 2.2, 0.0, -2.5, -2.0, 2.1]], ids=str
)
def test_from_where_joints_are_counted_changes_nothing(arm, shift):
    other = recounted(arm, np.array(shift))
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (20, 6))
    T = fk(arm, q)
    np.testing.assert_allclose(fk(other, q - shift).matrix, T.matrix, atol=1e-14)
    assert other.branch == arm.branch and other.branch_is_unique
    np.testing.assert_allclose(ik(other, T, q - shift), q - shift, atol=1e-9)


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_whole_turns_in_its_offsets_change_nothing(arm):
    other = replace(arm, offsets=tuple(np.array(arm.offsets) + 2 * np.pi * np.array([1, -1, 0, 2, 1, -2])))
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (20, 6))
    assert other.branch_is_unique
    np.testing.assert_allclose(ik(other, fk(arm, q), q), q, atol=1e-9)


@pytest.mark.parametrize("joint", [1, 4, 5])
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_range_beyond_a_right_angle_from_its_branch_holds_two_branches(joint, end):
    def reaching(degrees):
        joints = list(PSM_CLASSIC.joints)
        joints[joint] = replace(joints[joint], **{end: np.radians(degrees if end == "upper" else -degrees)})
        return replace(PSM_CLASSIC, joints=tuple(joints))

    assert reaching(90).branch_is_unique
    assert not reaching(90.01).branch_is_unique


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_a_widened_arm_goes_further_at_both_ends_and_is_the_same_otherwise(arm):
    wide = arm.widened(0.2, 0.03)
    more = np.array([0.2, 0.2, 0.03, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(wide.lower, arm.lower - more)
    np.testing.assert_allclose(wide.upper, arm.upper + more)
    np.testing.assert_array_equal(fk(wide, arm.middle).matrix, fk(arm, arm.middle).matrix)


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
