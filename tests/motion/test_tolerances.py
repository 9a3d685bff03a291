from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import fk, ik, jacobian
from trocar.geometry import SE3, SO3
from trocar.motion import ArmMotion, MotionProblem, TimedPath
from trocar.motion.tolerances import joint_strays, passed_over, passing_deviation, sag_m
from trocar.trajectory import Trajectory
from waypoints import FOUR, PAPER, PSM

ARM = ArmMotion(PSM, FOUR, PAPER, up=np.array([0.0, 0.0, 1.0]))


def passing(off_m, turn_rad=0.0):
    """A path that passes the second waypoint off by (3,), turned about the tool's axis."""
    tip = fk(PSM, FOUR[1])
    points = FOUR.copy()
    points[1] = ik(PSM, SE3.from_parts(tip.rotation @ SO3.axis("z", turn_rad), tip.translation_m + off_m), FOUR[1])
    return TimedPath(Trajectory.hermite(np.arange(4.0), points, np.zeros((4, 6))), np.arange(4.0))


@pytest.mark.parametrize(
    ("off_mm", "told_mm"),
    [([0.3, 0.4, 0.0], 0.5), ([0.3, 0.4, 0.6], 0.6), ([0.3, 0.4, -0.6], 0.6), ([0.3, -0.4, -0.2], 0.5)],
)
def test_a_waypoint_is_passed_at_the_greater_of_the_distances_along_up_and_aside(off_mm, told_mm):
    off_m, off_rad = passing_deviation(ARM, passing(1e-3 * np.array(off_mm), 0.02), 1)
    assert off_m == pytest.approx(1e-3 * told_mm) and off_rad == pytest.approx(0.02)
    tilted = replace(ARM, up=np.array([1.0, 0.0, 0.0]))
    expected = max(abs(off_mm[0]), np.hypot(*off_mm[1:]))
    assert passing_deviation(tilted, passing(1e-3 * np.array(off_mm)), 1)[0] == pytest.approx(1e-3 * expected)


def test_a_tip_sinks_below_the_lower_of_two_waypoints():
    """The insertion alone moves the tip along the tool's axis, which is down here."""
    begin = np.array([0, 0, 0.15, 0, 0, 0])
    up = fk(PSM, begin).translation_m - fk(PSM, begin + [0, 0, 0.01, 0, 0, 0]).translation_m
    q = np.tile(begin, (4, 1))
    q[:, 2] += 0.0, 0.012, 0.005, 0.03
    arm = ArmMotion(PSM, q[[0, 2, 3]], PAPER, up=up)
    path = TimedPath(Trajectory.hermite([0.0, 0.1234, 0.3, 0.4], q, np.zeros((4, 6))), [0.0, 0.3, 0.4])
    assert sag_m(arm, path, 0) == pytest.approx(0.007, abs=2e-6)
    assert sag_m(arm, path, 1) == pytest.approx(0.0, abs=1e-12)  # it ends at the lower one
    assert sag_m(replace(arm, up=-up), path, 1) == pytest.approx(0.0, abs=1e-12)


def test_pieces_that_are_passed_over_are_free_and_have_a_waypoint_between():
    assert passed_over(ARM) == [0, 1, 2]
    assert passed_over(replace(ARM, straight=(True, False, True))) == [1]
    assert passed_over(replace(ARM, waypoints=FOUR[:2], straight=())) == []
    assert passed_over(replace(ARM, waypoints=FOUR[:3], straight=())) == [0, 1]
    moving = replace(ARM, start_velocity=np.full(6, 1e-3))
    assert passed_over(moving) == [1, 2]


def test_joints_may_stray_as_far_as_the_tip_may():
    inverse = np.linalg.inv(jacobian(PSM, FOUR[1]))

    def strays(waypoints=FOUR, **tolerances):
        arm = replace(ARM, waypoints=waypoints)
        return joint_strays(arm, MotionProblem({"it": arm}, **tolerances))

    assert strays() is None
    kinds = (("waypoint_tolerance_m", inverse[:, :3], np.sqrt(2)), ("waypoint_tolerance_rad", inverse[:, 3:], 1.0))
    for name, block, root in kinds:
        found = strays(**{name: 1e-4})
        assert not found[[0, 3]].any()
        share = found[1] / (root * 1e-4 * np.sqrt(np.square(block).sum(axis=1)))
        assert np.all(share > 1.0) and np.all(share < 1.1)  # a little more than what is linear tells
    both = strays(waypoint_tolerance_m=1e-4, waypoint_tolerance_rad=2e-4)
    apart = strays(waypoint_tolerance_m=1e-4) + 2 * strays(waypoint_tolerance_rad=1e-4)
    np.testing.assert_allclose(both, apart)


def test_where_the_arm_is_singular_joints_may_be_anywhere(monkeypatch):
    def singular(model, q):
        return np.eye(6) * (0 if np.allclose(q, FOUR[1]) else 1)

    monkeypatch.setattr("trocar.motion.tolerances.jacobian", singular)
    found = joint_strays(ARM, MotionProblem({"it": ARM}, waypoint_tolerance_m=1e-3))
    assert np.isinf(found[1]).all() and np.isfinite(found[[0, 2, 3]]).all() and found[2, 0] > 0
