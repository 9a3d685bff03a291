from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.suture.planning import PRESETS, Reward, dexterity
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.gaps import plan_gaps
from trocar.tasks.suture.planning.plan import Spacing
from trocar.tasks.suture.planning.robust import (
    CABLES_RAD,
    Scenarios,
    Uncertainty,
    maps,
    plan_robust,
    sensitivity,
    worst_map,
)

SETUP = PRESETS["default"].setup


@pytest.fixture(scope="module")
def nominal():
    return dexterity(SETUP, positions=72)


@pytest.fixture(scope="module")
def scenarios():
    return Scenarios.draw(np.random.default_rng(3), 40)


def test_without_errors_nothing_changes(nominal):
    still = Scenarios.draw(np.random.default_rng(0), 5, Uncertainty((0, 0, 0), 0, 0))
    robust = plan_robust(nominal, still)
    assert robust.plan.reward == robust.nominal_worst == robust.planned_reward == plan_even(nominal).reward
    found = sensitivity(nominal, still)
    assert found.feasible.all()
    assert not found.regret.any()
    assert not found.shift_rad.any()


def test_joints_in_error_stand_where_the_scenario_says(nominal, scenarios):
    for there, error in zip(maps(nominal, scenarios), scenarios.joints_rad, strict=True):
        q = there.joints.q.copy()
        q[..., 3:] -= error
        T_planned_circle = SETUP.circle.T_world_circle.inverse() @ there.setup.circle.T_world_circle
        T_base_tip = fk(SETUP.arm, nominal.joints.q)
        moved = SETUP.T_base_circle @ T_planned_circle @ SETUP.T_base_circle.inverse() @ T_base_tip
        np.testing.assert_allclose(fk(SETUP.arm, q).matrix, moved.matrix, atol=1e-9)


def test_an_error_of_the_joints_costs_at_most_its_share_of_the_limit():
    nominal = dexterity(SETUP, Reward(weight=1.0), 72)
    alone = Scenarios.draw(np.random.default_rng(5), 30, Uncertainty(translation_m=0, rotation_rad=0))
    lost = np.array([nominal.margin - there.margin for there in maps(nominal, alone)])
    share = np.abs(alone.joints_rad / SETUP.arm.upper[3:]).max(1)
    assert np.all(np.abs(lost) <= share[:, None, None] + 1e-12)
    assert np.abs(lost).max() > 0.9 * share.max()


def test_the_robust_plan_is_the_best_worst_case_by_brute_force(nominal, scenarios):
    values = np.array([there.values for there in maps(nominal, scenarios)]).min(0)
    can = np.array([there.joints.feasible for there in maps(nominal, scenarios)]).all(0)
    assert can.any(0).all()
    worst = np.where(can, values, -np.inf).max(0)
    best = max(min(worst[start::18]) for start in range(18))
    found = plan_robust(nominal, scenarios)
    assert found.plan.reward == pytest.approx(best, abs=1e-12)
    assert found.plan.feasible
    assert found.nominal_worst <= found.plan.reward
    assert found.planned_reward <= found.nominal.reward
    assert "worst of 40 scenarios (random)" in found.plan.certified


def test_the_worst_case_of_the_nominal_plan_is_told_alike_by_both(nominal, scenarios):
    told = sensitivity(nominal, scenarios)
    assert plan_robust(nominal, scenarios).nominal_worst == pytest.approx(told.rewards.min(), abs=1e-12)
    assert told.rewards[0] == pytest.approx(told.plan.reward, abs=1e-12)
    assert np.all(told.regret[told.feasible] >= -1e-12)
    assert np.all(told.shift_rad <= np.pi / 4 + 1e-9)


def test_a_given_plan_is_followed_in_place_of_the_best(nominal, scenarios):
    robust = plan_robust(nominal, scenarios)
    told = sensitivity(nominal, scenarios, plan=robust.plan)
    assert told.plan is robust.plan
    assert told.rewards.min() == pytest.approx(robust.plan.reward, abs=1e-12)
    assert told.rewards[0] == pytest.approx(robust.planned_reward, abs=1e-12)


def test_corners_are_balanced_and_lie_at_the_standard_deviations():
    corners = Scenarios.corners(deviations=2.0)
    joints, twists = corners.joints_rad / (2 * np.array(CABLES_RAD)), corners.T_planned_circle.log()
    assert len(corners) == 33
    assert not joints[0].any()
    np.testing.assert_allclose(np.abs(joints[1:]), 1.0)
    signs = np.hstack([joints[1:], np.sign(twists[1:])])
    np.testing.assert_allclose(signs.T @ signs, 32 * np.eye(9), atol=1e-9)
    np.testing.assert_allclose(np.abs(twists[1:]), np.repeat([0.002, np.radians(2.0)], [3, 3])[None].repeat(32, 0))


def test_the_plan_for_the_corners_loses_next_to_nothing_in_random_errors():
    nominal = dexterity(SETUP)
    found = plan_robust(nominal, Scenarios.corners())
    random = list(maps(nominal, Scenarios.draw(np.random.default_rng(11), 120)))
    values = np.array([there.values[there.choice, np.arange(360)] for there in random])
    low = np.percentile(values.reshape(120, 4, 90).min(1), 5, axis=0)
    start = int(np.rint(np.degrees(found.plan.positions_rad[0])))
    assert low[start] > low.max() - 0.01
    assert np.median(low) < low.max() - 0.05


def test_more_scenarios_never_make_the_worst_case_better(nominal, scenarios):
    def first(count):
        return Scenarios(scenarios.joints_rad[:count], SE3(scenarios.T_planned_circle.matrix[:count]))

    worst = [plan_robust(nominal, first(count)).plan.reward for count in (1, 5, 20, 40)]
    assert worst == sorted(worst, reverse=True)
    assert worst[0] > worst[-1]


def test_greater_errors_cost_more(nominal):
    def worst(scale):
        sd = Uncertainty((0.007 * scale, 0.020 * scale, 0.014 * scale), 0.001 * scale, 0.0175 * scale)
        return plan_robust(nominal, Scenarios.draw(np.random.default_rng(1), 40, sd)).plan.reward

    assert worst(0.5) > worst(1) > worst(2)


def test_a_suture_is_feasible_in_the_worst_map_only_if_it_is_in_every_scenario(nominal):
    wild = Scenarios.draw(np.random.default_rng(2), 20, Uncertainty((0.1, 0.2, 0.2), 0.01, 0.2))
    every = np.array([there.joints.feasible for there in maps(nominal, wild)]).all(0)
    assert 0 < every.sum() < every.size
    np.testing.assert_array_equal(worst_map(nominal, wild).joints.feasible, every)


def test_any_planner_on_the_grid_can_be_made_robust(nominal, scenarios):
    spacing = Spacing(np.radians(40), np.radians(80))
    found = plan_robust(nominal, scenarios, lambda map: plan_gaps(map, 6, spacing))
    assert len(found.plan.directions) == 6
    assert found.nominal_worst <= found.plan.reward <= found.planned_reward <= found.nominal.reward
    found.summary()


def test_a_plan_off_the_grid_and_errors_out_of_bounds_are_refused(nominal, scenarios):
    def off_grid(map):
        plan = plan_even(map)
        return replace(plan, positions_rad=plan.positions_rad + 0.01)

    with pytest.raises(TrocarError, match="on the map's grid"):
        plan_robust(nominal, scenarios, off_grid)
    with pytest.raises(TrocarError, match=r"give 0 to 0\.2 for each"):
        Uncertainty(translation_m=np.nan)
    with pytest.raises(TrocarError, match="at 7 standard deviations"):
        Scenarios.corners(deviations=7)
    with pytest.raises(TrocarError, match="number of scenarios is 0"):
        Scenarios.draw(np.random.default_rng(0), 0)
