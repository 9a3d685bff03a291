"""What is asked of arms, and what of it cannot be."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import MotionLimits, fk
from trocar.errors import AlreadyThere, OutOfReach, TrocarError
from trocar.geometry import SE3
from trocar.motion import (
    ArmMotion,
    Capsule,
    HalfSpace,
    MotionProblem,
    MovingArm,
    TimedPath,
    limit_use,
    open_box,
    plan_motion,
    wall,
)
from trocar.motion.bodies import stacked
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT, transfer

ONE = ArmMotion(PSM, FOUR, PAPER)
HOLD = Trajectory([0.0, 1.0], FOUR[:1][None])
FIVE_JOINTS = MotionLimits(np.ones(5), np.ones(5))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"waypoints": FOUR[:1]}, r"shape \(n, 6\) with n of 2 or more"),
        ({"waypoints": FOUR[:, :5]}, r"shape \(n, 6\)"),
        ({"waypoints": FOUR * [1, 1, np.nan, 1, 1, 1]}, "joint 'insertion' is nan; give a finite number"),
        ({"limits": FIVE_JOINTS}, "limits of 6 joints, got 5"),
        ({"up": "z"}, "the upward direction is z; give three finite numbers"),
        ({"waypoints": [["a"] * 6] * 2}, r"waypoints of psm-classic must be numbers of shape \(n, 6\)"),
        ({"limits": 2.0}, r"MotionLimits\(velocity, acceleration\), got float"),
        ({"T_world_base": 2 * np.eye(4)}, "length 1 at right angles"),
        ({"T_world_base": SE3.identity((2,))}, r"T_world_base of psm-classic needs one pose \(4, 4\), got \(2, 4, 4\)"),
        ({"up": np.zeros(3)}, "the upward direction is .* give three finite numbers that are not all 0"),
        ({"start_velocity": np.full(6, np.inf)}, "start velocity of psm-classic must be finite, got inf"),
        ({"start_velocity": np.array([0, 0, 0.5, 0, 0, 0])}, "joint 'insertion' starts with 0.5000 m/s, beyond .* 0.4"),
        ({"jaw_rad": np.nan}, "jaws of psm-classic open nan rad; give a finite number"),
        ({"T_base_goals": SE3.identity()}, r"goals are poses \(m, 4, 4\)"),
    ],
)
def test_what_is_asked_of_an_arm_is_checked(change, words):
    with pytest.raises(TrocarError, match=words) as raised:
        replace(ONE, **change)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"arms": {}}, "at least one arm"),
        ({"arms": {"psm1": FOUR}}, "arms of a motion problem are .*; give ArmMotion by name"),
        ({"obstacles": {"peg": [0, 0, 0]}}, "give Capsule or HalfSpace by name"),
        ({"min_distance_m": -1e-3}, "min_distance_m of a motion problem is -0.001; give a finite number of at least 0"),
        ({"range_slack": np.nan}, "range_slack of a motion problem is nan"),
        ({"obstacles": {"psm1": Capsule([0, 0, 0])}}, "two things are called psm1"),
        (
            {"arms": {"psm1": replace(ONE, waypoints=FOUR + [0, 0, 0.1, 0, 0, 0])}},
            r"waypoint 0, joint 'insertion' .* m is outside \[0.0000, 0.2400\] m of psm-classic; move it inside",
        ),
    ],
)
def test_a_problem_is_checked(asked, words):
    with pytest.raises(TrocarError, match=words) as raised:
        MotionProblem(**{"arms": {"psm1": ONE}, **asked})
    assert "\n" not in str(raised.value)


def test_one_of_several_arms_that_is_asked_too_much_is_named():
    beyond = transfer(RIGHT, (0.02, 0.0), (0.05, 0.0))
    beyond = replace(beyond, waypoints=beyond.waypoints + [0, 1, 0, 0, 0, 0])
    with pytest.raises(TrocarError, match="arm 'psm2': waypoint 0, joint 'pitch'"):
        MotionProblem({"psm1": transfer(LEFT, (-0.05, 0.0), (-0.02, 0.0)), "psm2": beyond})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MovingArm(PSM, HOLD, SE3.identity((2,))), "needs one pose"),
        (lambda: MovingArm(PSM, HOLD, np.zeros((4, 4))), "length 1 at right angles"),
        (lambda: TimedPath(FOUR, [0.0, 1.0]), "needs a Trajectory, got ndarray"),
        (lambda: TimedPath(HOLD, [0.0, np.nan]), "times must be finite"),
        (lambda: Capsule([0, 0]), r"start of a capsule must have shape \(3,\), got \(2,\)"),
        (lambda: Capsule([0, 0, 0], [0, 0, np.nan]), r"end of a capsule must be finite, got nan at \[2\]"),
        (lambda: Capsule([0, 0, 0], radius_m=-1e-9), "radius of a capsule is -1e-09 m; give a finite radius"),
        (lambda: Capsule([0, 0, 0], radius_m=np.inf), "radius of a capsule is inf m"),
        (lambda: HalfSpace([0, 0, 0], [0, 0, 0]), r"normal of a half-space is \[0, 0, 0\]; give three"),
        (lambda: wall("fence", [0, 0], [1, 0], 0.02, 0.002), "foot of wall 'fence' must have shape"),
        (lambda: wall("fence", [0, 0, 0], [1, 0, 0], np.inf, 0.002), "cannot be inf m high"),
        (lambda: open_box("tray", SE3.identity(), (0.1, np.nan), 0.02, 0.002), "inside of box 'tray' must be finite"),
        (lambda: open_box("tray", SE3.identity(), (0.1, -0.1), 0.02, 0.002), "give two lengths above 0"),
        (lambda: limit_use(PSM, HOLD, FIVE_JOINTS), "6 joints, its trajectory 6 and the limits 5"),
    ],
)
def test_parts_of_a_motion_are_checked(make, words):
    with pytest.raises(TrocarError, match=words) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_goals_become_the_waypoints_nearest_to_those_before():
    turned = FOUR.copy()
    turned[:, 3] += np.array([0.0, 1.6, 3.2, 4.2])  # the roll goes round, beyond half a turn
    goals = fk(PSM, turned[1:])
    asked = ArmMotion(PSM, turned[:1], PAPER, T_base_goals=goals, straight=(True, False, True))
    resolved = MotionProblem({"psm1": asked}).resolved().arms["psm1"]
    np.testing.assert_allclose(resolved.waypoints, turned, atol=1e-9)
    assert resolved.T_base_goals is None and resolved.straight == (True, False, True)


def test_a_goal_out_of_reach_is_a_reason():
    goals = SE3.from_parts(translation_m=[[0.1, 0.0, -0.12], [0.0, 0.0, -0.5]])
    plan = plan_motion(MotionProblem({"psm1": ArmMotion(PSM, FOUR[:1], PAPER, T_base_goals=goals)}))
    assert not plan.found and not plan.paths
    assert plan.reason.startswith("arm 'psm1', goal 1: ")
    assert isinstance(plan.refusal, OutOfReach) and plan.refusal.arm == "psm1"


def test_a_goal_where_the_arm_already_is_needs_no_motion():
    goals = fk(PSM, FOUR[:1])
    plan = plan_motion(MotionProblem({"psm1": ArmMotion(PSM, FOUR[:1], PAPER, T_base_goals=goals)}))
    assert isinstance(plan.refusal, AlreadyThere) and plan.refusal.arm == "psm1" and not plan.paths


def test_to_stop_and_come_back_is_a_motion():
    ArmMotion(PSM, FOUR[[0, 0]], PAPER, start_velocity=np.full(6, 0.01))
    with pytest.raises(AlreadyThere, match="coincide"):
        ArmMotion(PSM, FOUR[[0, 0]], PAPER)


def test_obstacles_are_capsules():
    ends = stacked(
        {
            "ball": Capsule([1, 0, 0], radius_m=0.1),
            "rod": Capsule([0, 0, 0], [0, 0, 1], 0.2),
            "t": HalfSpace(*np.eye(3)[:2]),
        }
    )
    np.testing.assert_array_equal(ends.ends_m[:2], [[[1, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 0, 1]]])
    np.testing.assert_array_equal(ends.radii_m[:2], [0.1, 0.2])
    assert stacked({}).ends_m.shape == (0, 2, 3)


@pytest.mark.parametrize("away_m", [0.0, 0.5, 2.0])
def test_the_ball_of_a_half_space_is_as_good_as_its_plane(away_m):
    normal = np.array([0.6, 0.0, 0.8])
    ball = stacked({"table": HalfSpace([0.1, 0.2, 0.3], 5 * normal)})
    aside = away_m * np.array([0.8, 0.0, -0.6])
    for height_m in (-0.01, 0.0, 0.1):
        point = np.array([0.1, 0.2, 0.3]) + aside + height_m * normal
        distance_m = np.linalg.norm(point - ball.ends_m[0, 0]) - ball.radii_m[0]
        assert height_m - 1.1e-6 < distance_m <= height_m


def test_remote_centres_are_a_millimetre_apart_at_least():
    moved = replace(ONE, T_world_base=SE3.from_parts(translation_m=[0.3, 0.2, 0.1]))
    for aside_m, apart in ((0.9e-3, False), (1.1e-3, True)):
        other = MovingArm.resting(PSM, FOUR[0], SE3.from_parts(translation_m=[0.3 + aside_m, 0.2, 0.1]))
        if apart:
            assert MotionProblem({"psm1": moved}, others={"psm2": other}).others
        else:
            with pytest.raises(TrocarError, match="'psm1' and 'psm2' share one remote centre"):
                MotionProblem({"psm1": moved}, others={"psm2": other})


def test_what_is_not_said_of_a_problem():
    problem = MotionProblem({"psm1": ONE})
    assert problem.min_distance_m == problem.range_slack == 0.0
    assert (problem.straight_tolerance_m, problem.straight_tolerance_rad) == (1e-4, 1e-3)
    assert repr(problem) == "<MotionProblem psm1: <ArmMotion of psm-classic through 4 waypoints>>"
    around = MotionProblem({"psm1": ONE}, obstacles={"ball": Capsule([1, 0, 0])}, min_distance_m=2e-3)
    assert repr(around).endswith("; 2 mm from ball>")


def test_what_is_not_said():
    assert ONE.straight == (False, False, False) and not ONE.fixed_wrist and not ONE.moves
    np.testing.assert_array_equal(ONE.up, [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(ONE.start_velocity, np.zeros(6))
    np.testing.assert_array_equal(ONE.T_world_base.matrix, np.eye(4))
    assert ONE.jaw_rad == 0.0 and ONE.max_tip_m_s == np.inf and ONE.facing is None
    np.testing.assert_allclose(replace(ONE, up=[0.0, 3.0, 4.0]).up, [0.0, 0.6, 0.8])
    assert repr(ONE) == "<ArmMotion of psm-classic through 4 waypoints>"


def test_waypoints_and_goals_count_together():
    goals = fk(PSM, FOUR[2:])
    both = ArmMotion(PSM, FOUR[:2], PAPER, T_base_goals=goals)
    assert len(both.straight) == 3 and repr(both).endswith("through 2 waypoints and 2 goals>")
    assert len(ArmMotion(PSM, FOUR[:1], PAPER, T_base_goals=goals[:1]).straight) == 1
    np.testing.assert_allclose(both.resolved().waypoints, FOUR, atol=1e-9)
    assert ONE.resolved() is ONE
    for points, words in ((FOUR[:0], "got \\(0, 6\\) and 2 goals"), (FOUR[0], "got \\(6,\\) and 2 goals")):
        with pytest.raises(TrocarError, match=words):
            ArmMotion(PSM, points, PAPER, T_base_goals=goals)
    with pytest.raises(TrocarError, match="4 waypoints have 3 pieces between them, but 4 times"):
        ArmMotion(PSM, FOUR[:2], PAPER, T_base_goals=goals, straight=(True,) * 4)


@pytest.mark.parametrize(("off", "apart"), [(0.9e-9, False), (1.1e-9, True)])
def test_waypoints_differ_in_some_joint(off, apart):
    points = FOUR.copy()
    points[2] = points[1]
    points[2, 4] += off
    if apart:
        assert len(ArmMotion(PSM, points, PAPER).waypoints) == 4
    else:
        with pytest.raises(TrocarError, match="waypoints 1 and 2 coincide; remove one"):
            ArmMotion(PSM, points, PAPER)
        with pytest.raises(TrocarError, match="waypoints 1 and 2 coincide"):  # only the first piece may come back
            ArmMotion(PSM, points, PAPER, start_velocity=np.full(6, 0.01))


@pytest.mark.parametrize("joint", [0, 4])
def test_a_start_is_as_fast_as_the_limit_and_no_faster(joint):
    for sign in (1.0, -1.0):
        start = np.zeros(6)
        start[joint] = sign * PAPER.velocity[joint] * (1 + 0.5e-9)
        assert ArmMotion(PSM, FOUR, PAPER, start_velocity=start).moves
        start[joint] *= 1 + 1e-8
        with pytest.raises(TrocarError, match=f"joint '{PSM.joints[joint].name}' starts with"):
            ArmMotion(PSM, FOUR, PAPER, start_velocity=start)


@pytest.mark.parametrize("joint", [2, 5])
def test_waypoints_lie_within_the_ranges_and_their_slack(joint):
    extent = PSM.upper[joint] - PSM.lower[joint]
    for bound, sign in ((PSM.upper[joint], 1.0), (PSM.lower[joint], -1.0)):
        points = FOUR.copy()
        points[1, joint] = bound + sign * 0.01 * extent
        arm = ArmMotion(PSM, points, PAPER)
        arm.require_ranges(0.01 + 1e-9)
        with pytest.raises(TrocarError, match=f"waypoint 1, joint '{PSM.joints[joint].name}'"):
            arm.require_ranges(0.01 - 1e-6)
        points[1, joint] = bound + sign * 1e-7
        with pytest.raises(TrocarError, match="is outside") as refused:
            ArmMotion(PSM, points, PAPER).require_ranges(0.0)
        value, low, high = (float(number) for number in re.findall(r"-?\d+\.\d+", str(refused.value)))
        assert not low <= value <= high, "it reads as outside"


def test_a_tip_may_be_as_slow_as_you_like_but_must_move():
    assert replace(ONE, max_tip_m_s=1e-6).max_tip_m_s == 1e-6
    for speed in (0.0, -1.0, np.nan):
        with pytest.raises(TrocarError, match="give a speed above 0"):
            replace(ONE, max_tip_m_s=speed)
