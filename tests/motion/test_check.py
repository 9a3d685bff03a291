"""What the check of a planner's answer refuses, from both sides of each of its bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import MotionLimits, fk, ik
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import (
    ArmMotion,
    Capsule,
    Demand,
    Facing,
    MotionProblem,
    MovingArm,
    TimedPath,
    plan_motion,
    vertical_deviation_m,
)
from trocar.motion.check import check, line_deviation, tip_use
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
    at_once = path_of(FOUR, times=[0.0, 3.0, 3.0, 9.0])  # waypoints may be passed at the same time
    assert "misses waypoint" in found(at_once, ALL)[0][0]


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


def followed(T_base_tips, seconds=3.0):
    """The path through dense poses, from rest to rest, its ends being its waypoints."""
    q = ik(PSM, T_base_tips)
    times = np.linspace(0.0, seconds, len(q))
    velocity = np.gradient(q, times, axis=0)
    velocity[[0, -1]] = 0.0
    return ArmMotion(PSM, q[[0, -1]], PAPER, straight=(True,)), TimedPath(
        Trajectory.hermite(times, q, velocity), times[[0, -1]]
    )


def poses(line_m, turn_rad, aside_m=0.0, tilt_rad=0.0, count=241):
    """From one tip pose along a line and about the tool's axis, with a bulge aside and a tilt in the middle."""
    start = fk(PSM, FOUR[1])
    done = np.linspace(0, 1, count)
    done = done**2 * (3 - 2 * done)
    bulge = np.sin(np.pi * done) ** 2
    places = start.translation_m + np.outer(done, line_m) + np.outer(bulge, [0, aside_m, 0])
    turns = SO3.axis("z", turn_rad * done) @ SO3.axis("x", tilt_rad * bulge)
    return SE3.from_parts(start.rotation @ turns, places)


LINES = [([0.02, 0.0, 0.01], 0.0), ([0.02, 0.0, 0.01], 0.6), ([0.0, 0.0, 0.0], 0.6)]


@pytest.mark.parametrize(("line_m", "turn_rad"), LINES)
def test_a_straight_path_is_straight_whether_it_moves_turns_or_both(line_m, turn_rad):
    off_m, off_rad = line_deviation(*followed(poses(line_m, turn_rad)), piece=0)
    assert off_m < 2e-6 and off_rad < 2e-4
    motion, path = followed(poses(line_m, turn_rad))
    assert plan_motion(MotionProblem({"psm1": motion}), lambda problem: {"psm1": path}).found


@pytest.mark.parametrize(("line_m", "turn_rad"), LINES)
def test_a_bulge_and_a_tilt_are_measured(line_m, turn_rad):
    off_m, off_rad = line_deviation(*followed(poses(line_m, turn_rad, aside_m=1e-3)), piece=0)
    assert off_m == pytest.approx(1e-3, rel=1e-2) and off_rad < 0.05
    off_m, off_rad = line_deviation(*followed(poses(line_m, turn_rad, tilt_rad=0.02)), piece=0)
    assert off_m < 2e-6 and off_rad == pytest.approx(0.02, rel=1e-2)
    motion, path = followed(poses(line_m, turn_rad, tilt_rad=0.02))
    plan = plan_motion(MotionProblem({"psm1": motion}), lambda problem: {"psm1": path})
    assert "turns 0.02" in plan.reason and "straight piece 0, not 0.0010 rad" in plan.reason
    loose = MotionProblem({"psm1": motion}, straight_tolerance_rad=0.03)
    assert plan_motion(loose, lambda problem: {"psm1": path}).found


def test_to_turn_at_another_time_than_one_moves_is_a_turn_aside():
    """The turn goes with the way: first all of the one, then all of the other, is half a turn off."""
    first, then = poses([0.02, 0.0, 0.01], 0.0), poses([0.0, 0.0, 0.0], 0.6)
    moved = SE3(np.concatenate([first.matrix, (first[-1] @ then[0].inverse() @ then[1:]).matrix]))
    off_m, off_rad = line_deviation(*followed(moved, seconds=6.0), piece=0)
    assert off_m < 2e-6 and off_rad == pytest.approx(0.6, abs=1e-2)


def test_beyond_the_end_of_the_line_is_off_the_line():
    line = np.array([0.02, 0.0, 0.01])
    out, back = poses(1.1 * line, 0.0), poses(1.1 * line, 0.0)[::-1]
    there = SE3(np.concatenate([out.matrix, back.matrix[1:60]]))
    motion, path = followed(there, seconds=4.0)
    tips = fk(PSM, motion.waypoints).translation_m
    beyond_m = np.linalg.norm(out.translation_m[-1] - tips[1])
    assert line_deviation(motion, path, 0)[0] == pytest.approx(beyond_m, rel=1e-2)


def test_off_the_vertical():
    motion, path = followed(poses([0.0, 0.0, 0.02], 0.0, aside_m=1e-3))
    assert vertical_deviation_m(motion, path) == pytest.approx(1e-3, rel=1e-2)
    slanted = ArmMotion(PSM, motion.waypoints, PAPER, up=np.array([1.0, 0.0, 1.0]))
    assert vertical_deviation_m(slanted, path) == pytest.approx(0.02 * np.sqrt(0.5), rel=1e-2)


def test_each_piece_is_measured_between_its_own_waypoints():
    """There, back and there again; on the way back it bulges."""
    motion, there = followed(poses([0.02, 0.0, 0.01], 0.0))
    back = followed(poses([0.02, 0.0, 0.01], 0.0, aside_m=1e-3)[::-1])[1]
    arm = ArmMotion(PSM, motion.waypoints[[0, 1, 0, 1]], PAPER)
    path = TimedPath.joined([there.trajectory, back.trajectory, there.trajectory])
    off_m = [line_deviation(arm, path, piece)[0] for piece in range(3)]
    assert off_m[1] == pytest.approx(1e-3, rel=1e-2) and max(off_m[0], off_m[2]) < 2e-6


def test_verticals_are_those_of_the_lift_and_of_the_lowering():
    """Up, aside and down: what counts is off the foot's vertical on the first piece or the last."""
    even, bulging = (poses([0.0, 0.0, 0.02], 0.0, aside_m) for aside_m in (0.0, 1e-3))
    moved = poses([0.02, 0.0, 0.0], 0.0)
    for first, last, off_m in ((even, even, 0.0), (even, bulging, 1e-3), (bulging, even, 1e-3)):
        motion, lift = followed(first)
        lower = followed(last[::-1])[1]
        aside = followed(moved)[1]  # from and to other places: only the middle piece jumps
        path = TimedPath.joined([lift.trajectory, aside.trajectory, lower.trajectory])
        foot, top = motion.waypoints
        arm = ArmMotion(PSM, np.stack([foot, top, aside.trajectory(9.0), foot]), PAPER)
        assert vertical_deviation_m(arm, path) == pytest.approx(off_m, rel=1e-2, abs=2e-6)


def asked(**more):
    return MotionProblem({"psm1": ArmMotion(PSM, FOUR[:2], PAPER, **more)})


def test_an_angle_is_between_the_axis_and_the_way_to_the_point():
    facing = Facing([0.0, 2.0, 0.0], [0.0, 1.0, 0.0], 0.5)
    np.testing.assert_allclose(np.linalg.norm(facing.axis), 1.0)
    turned = SE3.from_parts(SO3.axis("z", np.array([0.0, 0.3, -2.0, np.pi])))
    np.testing.assert_allclose(facing.angle_rad(turned), [0.0, 0.3, 2.0, np.pi], atol=1e-12)
    aside = SE3.from_parts(translation_m=[1.0, 0.0, 0.0])
    assert facing.angle_rad(aside) == pytest.approx(np.pi / 4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"towards_m": [0, np.nan, 0]}, "'towards_m' of what a tip faces must be finite"),
        ({"axis": [0, 0, 0]}, "the axis that faces a point is .* not all 0"),
        ({"axis": [0, 1]}, "the axis that faces a point is .* three finite numbers"),
        ({"max_rad": 0.0}, "may face 0.0 rad aside; give an angle above 0"),
        ({"max_rad": 4.0}, "may face 4.0 rad aside"),
    ],
)
def test_what_cannot_be_faced_is_refused(given, words):
    with pytest.raises(TrocarError, match=words):
        Facing(**{"axis": [0, 1, 0], "towards_m": [0, 0, 1], "max_rad": 1.0} | given)


def test_a_planner_that_does_not_heed_the_tip_is_told_so_where_it_matters():
    assert plan_motion(asked(max_tip_m_s=1.0)).found
    plan = plan_motion(asked(max_tip_m_s=0.01))
    assert "the tip of 'psm1' moves at up to 0." in plan.reason and "m/s, not 0.0100" in plan.reason
    assert "'spline' ignores the speed of the tip, try " in plan.reason
    aside = plan_motion(asked(facing=Facing([0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 0.1)))
    assert "the tip of 'psm1' faces aside by up to" in aside.reason and "rad, not 0.1000" in aside.reason
    assert "'spline' ignores what the tip faces" in aside.reason
    assert plan_motion(asked(max_tip_m_s=0.01), "convex").found


def test_the_tips_greatest_speed_and_angle_are_found_at_50_hz_and_at_knots():
    """The insertion alone moves the tip, by a cubic from rest to rest: 1.5 d / t in the middle, a knot here."""
    q = np.array([0, 0, 0.1, 0, 0, 0]) + np.outer([0, 0.5, 1], [0, 0, 0.05, 0, 0, 0])
    velocity = np.outer([0, 1, 0], [0, 0, 1.5 * 0.05 / 0.301, 0, 0, 0])
    motion = Trajectory.hermite([0.0, 0.1505, 0.301], q, velocity)
    tip = fk(PSM, q[-1]).translation_m
    down = tip - fk(PSM, q[0]).translation_m
    aside = np.cross(down, [0.3, 0.4, 0.5])
    facing = Facing([1.0, 0.0, 0.0], tip + aside / np.linalg.norm(aside), 3.0)
    free, fast = ArmMotion(PSM, FOUR, PAPER), ArmMotion(PSM, FOUR, PAPER, max_tip_m_s=1.0)
    assert tip_use(free, motion) == (0.0, 0.0)
    speed, none = tip_use(fast, motion)
    assert speed == pytest.approx(1.5 * 0.05 / 0.301, rel=1e-9) and none == 0.0
    none, angle = tip_use(replace(free, facing=facing), motion)
    dense = facing.angle_rad(fk(PSM, motion(np.linspace(0, 0.301, 400)))).max()
    assert none == 0.0 and angle == pytest.approx(dense, abs=1e-4)
    there = replace(free, facing=facing, T_world_base=SE3.from_parts(SO3.axis("z", 0.7), [0.1, 0.2, 0.3]))
    assert abs(tip_use(there, motion)[1] - angle) > 0.1
    both = tip_use(replace(fast, facing=facing), motion)
    assert both == (speed, angle)


def test_between_knots_the_tip_is_looked_at_every_fiftieth_of_a_second():
    """Fastest at .1 s, where one of the samples is."""
    q = np.array([0, 0, 0.1, 0, 0, 0]) + np.outer([0, 1], [0, 0, 0.05, 0, 0, 0])
    motion = Trajectory.hermite([0.0, 0.2], q, np.zeros((2, 6)))
    fast = ArmMotion(PSM, FOUR, PAPER, max_tip_m_s=1.0)
    assert tip_use(fast, motion)[0] == pytest.approx(1.5 * 0.05 / 0.2, rel=1e-9)
    later = Trajectory.hermite([0.0, 0.02 * 6.999], q, np.zeros((2, 6)))  # 7 steps: the middle lies between two
    assert tip_use(fast, later)[0] == pytest.approx(1.5 * 0.05 / 0.13998 * (1 - (1 / 7) ** 2), rel=1e-6)


@pytest.mark.parametrize("max_rad", [1e-3, np.pi])
def test_any_angle_above_nothing_up_to_pi_may_be_faced(max_rad):
    assert Facing([0, 1, 0], [0, 0, 1], max_rad).max_rad == max_rad
    with pytest.raises(TrocarError, match="give an angle above 0, up to pi"):
        Facing([0, 1, 0], [0, 0, 1], np.nextafter(np.pi, 4))
