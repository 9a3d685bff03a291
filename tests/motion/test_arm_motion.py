from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.motion import ArmMotion
from waypoints import FOUR, PAPER, PSM

ONE = ArmMotion(PSM, FOUR, PAPER)


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
        with pytest.raises(TrocarError, match="waypoints 1 and 2 coincide"):
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


def test_a_tip_may_be_as_slow_as_you_like_but_must_move():
    assert replace(ONE, max_tip_m_s=1e-6).max_tip_m_s == 1e-6
    for speed in (0.0, -1.0, np.nan):
        with pytest.raises(TrocarError, match="give a speed above 0"):
            replace(ONE, max_tip_m_s=speed)
    with pytest.raises(TrocarError, match="give a finite number"):
        replace(ONE, jaw_rad=np.inf)
