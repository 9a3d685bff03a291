from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import ArmMotion, Facing, MotionProblem, plan_motion
from trocar.motion.tip import tip_speeds_m_s, tip_use
from trocar.trajectory import Trajectory
from waypoints import FOUR, PAPER, PSM


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


def test_a_tip_that_may_not_move_is_refused():
    with pytest.raises(TrocarError, match=r"may move at 0\.0 m/s; give a speed above 0"):
        asked(max_tip_m_s=0.0)


def test_speeds_are_those_of_the_jacobian():
    rng = np.random.default_rng(0)
    q, v = rng.uniform(PSM.lower, PSM.upper, (50, 6)), rng.normal(size=(50, 6))
    arm = ArmMotion(PSM, FOUR, PAPER)
    step = 1e-5
    apart = fk(PSM, q + step * v).translation_m - fk(PSM, q - step * v).translation_m
    np.testing.assert_allclose(tip_speeds_m_s(arm, q, v), np.linalg.norm(apart, axis=1) / (2 * step), rtol=1e-5)
    assert tip_speeds_m_s(arm, q, 0 * v).max() == 0.0


def test_a_planner_that_does_not_heed_the_tip_is_told_so_where_it_matters():
    assert plan_motion(asked(max_tip_m_s=1.0)).found
    plan = plan_motion(asked(max_tip_m_s=0.01))
    assert "the tip of 'psm1' moves at up to 0." in plan.reason and "m/s, not 0.0100" in plan.reason
    assert "'spline' ignores the speed of the tip, try " in plan.reason
    assert plan_motion(asked(max_tip_m_s=0.01), "convex").found


def test_a_tip_that_faces_aside_is_told():
    facing = Facing([0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 0.1)
    plan = plan_motion(asked(facing=facing))
    assert "the tip of 'psm1' faces aside by up to" in plan.reason and "rad, not 0.1000" in plan.reason
    assert "'spline' ignores what the tip faces" in plan.reason


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
