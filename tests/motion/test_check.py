"""What the check of a planner's answer refuses, from both sides of each of its bounds."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import MotionLimits, fk, ik
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.motion import ArmMotion, Capsule, Demand, Facing, MotionProblem, MovingArm, TimedPath
from trocar.motion.check import check
from trocar.motion.tip import tip_use
from trocar.motion.tolerances import line_deviation
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT

ONE = ArmMotion(PSM, FOUR[:2], PAPER)
ALL = ArmMotion(PSM, FOUR, PAPER)


def path_of(points, seconds=3.0, velocities=None, times=None):
    """A path that rests at all points, unless it has velocities there, and takes so long between two."""
    knots = seconds * np.arange(len(points))
    motion = Trajectory.hermite(knots, points, np.zeros_like(points) if velocities is None else velocities)
    return TimedPath(motion, knots if times is None else np.array(times))


def in_three(change=None):
    """From the first waypoint to the second in three pieces of a second; a change (4, 6) of the middle one."""
    q = FOUR[0] + np.linspace(0, 1, 4)[:, None] * (FOUR[1] - FOUR[0])
    motion = Trajectory.hermite(np.arange(4.0), q, np.zeros_like(q))
    coefficients = motion.coefficients.copy()
    if change is not None:
        coefficients[:, 1, 3] += change
    return TimedPath(Trajectory(motion.times_s, coefficients), np.array([0.0, 3.0]))


def found(path, arm=ONE, **asked):
    """The sentences about a path of an arm, and what they are about."""
    violations = check(MotionProblem({"it": arm}, **asked), {"it": path}).violations
    return [str(v) for v in violations], {v.demand for v in violations}


def test_a_sound_path_has_no_violation():
    result = check(MotionProblem({"it": ALL}), {"it": path_of(FOUR)})
    assert not result.violations
    assert 0 < result.use["it"].velocity_ratio < 1
    assert result.clearance.distance_m == np.inf


@pytest.mark.parametrize(
    ("point", "words"),
    [
        (0, ["'it' is off its waypoint at the start by 0.000001 rad or m"]),
        (1, ["'it' misses waypoint 1 at 3.000 s by 0.000001 rad or m"]),
        (
            3,
            [
                "'it' misses waypoint 3 at 9.000 s by 0.000001 rad or m",
                "'it' is off its waypoint at the end by 0.000001",
            ],
        ),
    ],
)
def test_waypoints_are_met_within_a_millionth(point, words):
    for off, refused in ((0.9e-6, False), (1.2e-6, True)):
        points = FOUR.copy()
        points[point, 3] -= off
        sentences, demands = found(path_of(points), ALL)
        assert len(sentences) == refused * len(words)
        assert demands == ({Demand.WAYPOINTS} if refused else set())
        assert all(sentence.startswith(start) for sentence, start in zip(sentences, words, strict=False))


def test_a_path_that_goes_on_after_its_last_waypoint_is_off():
    beyond = path_of([*FOUR, FOUR[3] + [0, 0, 0, 0.01, 0, 0]], times=[0.0, 3.0, 6.0, 9.0])
    assert found(beyond, ALL)[0] == ["'it' is off its waypoint at the end by 0.010000 rad or m"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ([0, 0, 0, 1.0], "'it' jumps at a knot, by 0.0000"),
        ([0, -1.0, 1.0, 0], "'it' jumps in velocity at a knot, by 0.0000"),
    ],
)
def test_a_path_hangs_together(change, words):
    for size, refused in ((0.9e-6, False), (1.1e-6, True)):
        sentences, _ = found(in_three(size * np.array(change)))
        assert len(sentences) == refused and all(words in sentence for sentence in sentences)


@pytest.mark.parametrize(
    ("row", "words"), [(0, "starts with a velocity that is off by"), (1, "does not rest at the end")]
)
def test_a_path_starts_as_it_is_asked_to_and_rests_at_the_end(row, words):
    going = np.array([0, 0, 0, 0.1, 0, 0])
    for off, refused in ((0.9e-6, False), (1.1e-6, True)):
        velocities = np.array([going, 0 * going])
        velocities[row, 3] += off
        arm = replace(ONE, start_velocity=going)
        sentences, _ = found(path_of(FOUR[:2], velocities=velocities), arm)
        assert len(sentences) == refused and all(words in sentence for sentence in sentences)


def test_the_joint_that_uses_most_of_a_limit_is_named():
    limits = MotionLimits(np.ones(6), np.ones(6), jerk=np.ones(6))
    q = PSM.middle + np.outer([0, 1], [0.1, 0.2, 0, 0, 0, 0])
    arm, path = ArmMotion(PSM, q, limits), path_of(q, seconds=1.0)
    sentences, demands = found(path, arm)
    assert demands == {Demand.LIMITS, Demand.JERK}
    assert sentences[0] == "joint 'pitch' of 'it' uses 1.200 of its acceleration limit"  # 6 d / t^2
    fast = path_of(q, seconds=0.25)  # 1.5 d / t
    assert found(fast, arm)[0][0] == "joint 'pitch' of 'it' uses 1.200 of its velocity limit"
    enough = ArmMotion(PSM, q, MotionLimits(np.full(6, 0.3), np.full(6, 1.2)))
    assert not found(path, enough)[0]


def test_ranges_may_be_left_by_the_slack_and_no_more():
    q = np.tile(PSM.middle, (2, 1))
    q[:, 2] = PSM.upper[2] - 1e-3
    q[1, 3] += 0.1
    velocities = np.zeros((2, 6))
    velocities[:, 2] = 0.01, 0.0
    arm, path = ArmMotion(PSM, q, PAPER, start_velocity=velocities[0]), path_of(q, 3.0, velocities)
    excess = 0.01 * 3.0 * 4 / 27 - 1e-3  # the greatest of v t (1 - t / T)^2
    share = excess / (PSM.upper[2] - PSM.lower[2])
    assert not found(path, arm, range_slack=share)[0]
    sentences, demands = found(path, arm, range_slack=0.999 * share)
    assert demands == {Demand.RANGES} and "joint 'insertion' of 'it' goes 0.0034 m out of its range" in sentences[0]


def test_straight_pieces_stray_and_turn_no_more_than_they_may():
    arm = replace(ALL, straight=(False, True, False))
    path = path_of(FOUR)
    off_m, off_rad = line_deviation(arm, path, 1)
    assert off_m > 1e-4 and off_rad > 1e-3
    for share_m, share_rad, words in (
        (1.0, 1.0, []),
        (0.999, 1.001, ["strays"]),
        (1.001, 0.999, ["turns"]),
        (0.9, 0.9, ["strays", "turns"]),
    ):
        tolerances = {"straight_tolerance_m": share_m * off_m, "straight_tolerance_rad": share_rad * off_rad}
        sentences, demands = found(path, arm, **tolerances)
        assert len(sentences) == len(words) and demands <= {Demand.STRAIGHT}
        assert all(word in s and "straight piece 1" in s for word, s in zip(words, sentences, strict=True))


def near_miss():
    """The four waypoints, the second one passed half a millimetre lower and turned."""
    points = FOUR.copy()
    points[1, 2:4] += -5e-4, 0.02
    return path_of(points)


def test_the_tip_is_no_faster_than_it_may_be():
    path = path_of(FOUR[:2])
    speed = tip_use(replace(ONE, max_tip_m_s=1.0), path.trajectory)[0]
    for more, refused in ((0.5e-6, False), (1.5e-6, True)):
        sentences, demands = found(path, replace(ONE, max_tip_m_s=speed / (1 + more)))
        assert demands == ({Demand.TIP_SPEED} if refused else set()), sentences


def test_the_tip_faces_no_further_aside_than_it_may():
    path, facing = path_of(FOUR[:2]), Facing([0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 3.0)
    angle = tip_use(replace(ONE, facing=facing), path.trajectory)[1]
    for less, refused in ((0.5e-9, False), (1.5e-9, True)):
        arm = replace(ONE, facing=replace(facing, max_rad=angle - less))
        sentences, demands = found(path, arm)
        assert demands == ({Demand.FACING} if refused else set()), sentences


def nearly_still(T_world_base=LEFT):
    """An arm that slides by a micrometre, so that distances are known at once."""
    q = FOUR[0] + np.outer([0, 1], [0, 0, -1e-6, 0, 0, 0])
    return ArmMotion(PSM, q, PAPER, T_world_base=T_world_base), path_of(q)


def ball_beside(arm, aside_m):
    tip = (arm.T_world_base @ fk(PSM, arm.waypoints[0])).translation_m
    return {"ball": Capsule(tip + [0.0, 0.0, -aside_m], radius_m=1e-3)}


def test_distances_are_kept_within_a_hundredth_of_a_millimetre():
    arm, path = nearly_still()
    ball = ball_beside(arm, 0.02)
    least_m = check(MotionProblem({"it": arm}, obstacles=ball, min_distance_m=1.0), {"it": path}).clearance.sampled_m
    assert 0.01 < least_m < 0.02
    for more_m, refused in ((0.8e-5, False), (1.2e-5, True)):
        sentences, demands = found(path, arm, obstacles=ball, min_distance_m=least_m + more_m)
        assert demands == ({Demand.DISTANCES} if refused else set())
        assert all(f"may come within {1e3 * least_m:.2f} mm of ball" in sentence for sentence in sentences)
    sentences, _ = found(path, arm, obstacles=ball_beside(arm, 0.0), min_distance_m=1e-3)
    assert "overlaps ball at" in sentences[0] and "1.00 mm were to be kept" in sentences[0]


def test_others_count_from_the_common_start_until_they_rest():
    arm, path = nearly_still(LEFT)
    tip = fk(PSM, arm.waypoints[0])
    meets_m = RIGHT.inverse().apply((LEFT @ tip).translation_m)
    hit, away = ik(PSM, SE3.from_parts(tip.rotation, meets_m), FOUR[0]), PSM.middle + [0, 0, -0.1, 0, 0, 0]
    comes, goes = (Trajectory.hermite([0.0, 1.0], ends, np.zeros((2, 6))) for ends in ([away, hit], [hit, away]))
    for motion, start_s, refused in ((comes, 20.0, True), (goes, -5.0, False), (goes, -0.01, True)):
        sentences, _ = found(path, arm, others={"other": MovingArm(PSM, motion, RIGHT, start_s)})
        assert ["overlaps" in sentence for sentence in sentences] == refused * [True]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (
            TimedPath(Trajectory([0.0, 1.0], np.zeros((1, 1, 5))), [0.0, 1.0]),
            "returned 5 joints for arm 'it'; it has 6",
        ),
        (path_of(FOUR[:2], times=[0.0, 1.0, 3.0]), "for the 2 waypoints of arm 'it'"),
        (path_of(FOUR[:2], times=[0.0, -1.0]), "must say when each is passed, in order"),
        (path_of(FOUR[:2], times=[0.0, np.nextafter(0.0, -1.0)]), "must say when each is passed, in order"),
        (path_of(FOUR[:2], times=[0.5, 3.0]), "motion of arm 'it' starts at 0.5 s; all start at 0"),
        (TimedPath(Trajectory([0.5, 1.0], FOUR[None, :1]), [0.0, 1.0]), "motion of arm 'it' starts at 0.5 s"),
    ],
)
def test_answers_of_another_shape_are_refused(path, words):
    with pytest.raises(TrocarError, match=words):
        check(MotionProblem({"it": ONE}), {"it": path})


def test_waypoints_are_passed_in_order_or_at_the_same_time():
    with pytest.raises(TrocarError, match="for the 4 waypoints of arm 'it'; it must say when each is passed, in order"):
        found(path_of(FOUR, times=[0.0, 3.0, 2.0, 9.0]), ALL)
    assert "misses waypoint" in found(path_of(FOUR, times=[0.0, 3.0, 3.0, 9.0]), ALL)[0][0]
