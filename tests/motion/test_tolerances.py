"""How far a motion may be off, and how straight it is."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.arms import fk, ik
from trocar.geometry import SE3, SO3
from trocar.motion import ArmMotion, MotionProblem, TimedPath, line_deviation, plan_motion, vertical_deviation_m
from trocar.trajectory import Trajectory
from waypoints import FOUR, PAPER, PSM


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


ARM = ArmMotion(PSM, FOUR, PAPER, up=np.array([0.0, 0.0, 1.0]))


def passing(off_m, turn_rad=0.0):
    """A path that passes the second waypoint off by (3,), turned about the tool's axis."""
    tip = fk(PSM, FOUR[1])
    points = FOUR.copy()
    points[1] = ik(PSM, SE3.from_parts(tip.rotation @ SO3.axis("z", turn_rad), tip.translation_m + off_m), FOUR[1])
    return TimedPath(Trajectory.hermite(np.arange(4.0), points, np.zeros((4, 6))), np.arange(4.0))
