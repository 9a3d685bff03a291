from dataclasses import replace
from functools import cache
from math import isinf, radians

import numpy as np
import pytest

from trocar.geometry import TURN
from trocar.tasks.suture.planning import PRESETS, Circle, Reward, Spacing, dexterity, plan_even, plan_gaps, refined

FINER = 100
FIXED_RAD = tuple(np.radians([60, 200]))
EVEN, FREE = Spacing.even(4), Spacing(radians(75), radians(105))
PROBLEMS = {
    "even": (4, EVEN),
    "free": (4, FREE),
    "many": (12, Spacing(radians(20), radians(40))),
    "bounded": (5, Spacing(radians(50), radians(100), ((radians(350.2), radians(20.7)),), FIXED_RAD)),
    "tense": (4, Spacing(radians(60), radians(120), tension=0.2)),
}
PROVEN = {
    **{("default", "even"): 0.60603, ("default", "free"): 0.65655, ("default", "many"): 0.54919},
    **{("paper-demo", "even"): 0.54925, ("paper-demo", "free"): 0.57875, ("paper-demo", "many"): 0.49429},
    **{("default", "tense"): 0.63906, ("paper-demo", "tense"): 0.58972},
}
"""Upper bounds on all plans at any angles, once proven by interval arithmetic through the inverse kinematics."""


@cache
def mapped(name="default"):
    return dexterity(PRESETS[name].setup, PRESETS[name].reward)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", PRESETS)
def test_any_angles_are_no_worse_than_the_grid_meet_the_spacing_and_have_the_rewards_that_they_say(name, problem):
    (count, spacing), map = PROBLEMS[problem], mapped(name)
    on_grid = plan_gaps(map, count, spacing)
    plan = refined(map, on_grid, spacing)
    assert plan.value >= on_grid.value and plan.feasible == on_grid.feasible
    assert plan.gaps_rad.min() > spacing.min_gap_rad - 1e-6 and plan.gaps_rad.max() < spacing.max_gap_rad + 1e-6
    assert spacing.allows(plan.positions_rad).all()
    for place in spacing.fixed_rad:
        assert np.abs(plan.positions_rad - place).min() < 1e-6
    again = map.at(plan.positions_rad)
    np.testing.assert_allclose(plan.rewards, again.best, rtol=0, atol=1e-12)
    assert plan.tension_cost == pytest.approx(spacing.tension * plan.unevenness)
    assert PROVEN.get((name, problem), plan.value) - 2e-4 < plan.value < PROVEN.get((name, problem), 1.0)
    assert isinf(plan.bound) and "nothing is proven" in plan.certified


def test_even_plans_are_as_good_as_those_of_a_grid_a_hundred_times_finer():
    map = mapped()
    fine = plan_even(map.at(TURN / (360 * FINER) * np.arange(360 * FINER)))
    plan = refined(map, plan_even(map), EVEN)
    assert plan.reward > plan_even(map).reward + 1e-4, "what whole degrees give away"
    assert plan.reward >= fine.reward - 1e-5


def test_tension_and_infeasible_sutures_count_as_on_the_grid():
    map = mapped("paper-demo")
    free = Spacing(radians(60), radians(120))
    uneven = [
        refined(map, plan_gaps(map, 4, spacing), spacing).unevenness
        for spacing in (free, replace(free, tension=0.2), replace(free, tension=10.0))
    ]
    assert uneven[0] >= uneven[1] >= uneven[2] == pytest.approx(0.0, abs=1e-4) and uneven[0] > 0.01
    far = dexterity(replace(PRESETS["default"].setup, circle=Circle(0.090)), Reward(), 72)
    on_grid = plan_gaps(far, 12, Spacing.even(12))
    plan = refined(far, on_grid, Spacing.even(12))
    assert not on_grid.feasible and not plan.feasible
    worst = [found.rewards[~far.at(found.positions_rad).feasible].min() for found in (on_grid, plan)]
    assert worst[1] >= worst[0]
