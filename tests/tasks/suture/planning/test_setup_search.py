from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
from trocar.tasks.suture.planning.parameters import with_parameters
from trocar.tasks.suture.planning.rewards import scored
from trocar.tasks.suture.planning.setup_search import GROUPS, _cost, free_bounds, jaws_above_m, search_setup

SETUP = PRESETS["default"].setup
FOLDED = with_parameters(SETUP, {"grasp_skew_rad": np.radians(90)})
START = dexterity(SETUP, positions=72)
FREE = (*GROUPS["circle"], *GROUPS["grasp"])


def searched(free=FREE, seed=0, **options):
    return search_setup(START, free, rng=np.random.default_rng(seed), evaluations=240, **options)


def reward_of(setup):
    return plan_even(scored(setup, START.reward, dexterity(setup, positions=72).joints, scales=START.scales)).reward


def test_the_best_setup_found_is_better_feasible_and_holdable_and_has_the_reward_that_it_says():
    done = []
    found = searched(progress=lambda *now: done.append(now))
    assert done[-1] == (240, 240) and found.evaluations == pytest.approx(240, abs=48)
    assert found.plan.reward > found.start.reward + 0.02 and found.plan.feasible
    assert found.best.setup.grasp.holdable and jaws_above_m(found.best.setup) >= 0
    assert reward_of(found.best.setup) == found.plan.reward
    again = with_parameters(SETUP, found.values)
    np.testing.assert_array_equal(again.T_base_circle.matrix, found.best.setup.T_base_circle.matrix)
    assert all(low - 1e-9 <= found.values[name] <= high + 1e-9 for name, (low, high) in found.bounds.items())
    assert searched().plan.reward == found.plan.reward, "one seed finds one setup"


def test_a_search_that_finds_nothing_better_returns_where_it_started():
    found = searched(("circle_radius_m",), bounds={"circle_radius_m": (0.0399, 0.04)})
    assert found.values == {"circle_radius_m": SETUP.circle.radius_m}
    assert found.plan.reward == found.start.reward == plan_even(START).reward


def test_it_finds_the_best_radius_that_a_fine_scan_finds():
    found = searched(("circle_radius_m",))
    scanned = [reward_of(with_parameters(SETUP, {"circle_radius_m": at})) for at in np.linspace(0.02, 0.04, 81)]
    assert found.plan.reward >= max(scanned) - 1e-3


def test_an_infeasible_plan_is_not_recommended_even_where_the_reward_alone_counts():
    reward_alone = replace(START.reward, feasible_first=False)
    bounds = {"base_up_m": (0.30, 0.31)}  # too far for the insertion
    for reward in (START.reward, reward_alone):
        far = dexterity(with_parameters(SETUP, {"base_up_m": 0.30}), reward, positions=72)
        found = search_setup(far, ("base_up_m",), rng=np.random.default_rng(0), evaluations=96, bounds=bounds)
        assert not (found.plan.feasible or found.sound)
    assert searched(("circle_radius_m",)).sound


def test_a_grasp_that_flat_jaws_cannot_hold_is_left():
    held = searched(("grasp_lean_rad", "grasp_skew_rad"), 1, setup=FOLDED)
    assert held.best.setup.grasp.holdable or held.best.setup.grasp == FOLDED.grasp


@pytest.mark.parametrize(
    ("rank", "worse_and_worse"),
    [
        ((-1, 0), [{"base_sideways_m": 0.05}]),
        ((10, 20), [{"base_up_m": 0.30}, {"base_up_m": 0.40}]),  # too far for the insertion
        # too near: the wrist gets too shallow
        ((10, 20), [{"base_sideways_m": 0.02, "base_up_m": up} for up in (0.07, 0.06, 0.05)]),
        ((30, 40), [{"grasp_skew_rad": 0.2}, {"grasp_skew_rad": 0.5}, {"grasp_skew_rad": 1.0}]),
        ((30, 40), [{"grasp_lean_rad": -0.6}, {"grasp_lean_rad": -0.9}]),
    ],
)
def test_the_search_is_led_out_of_setups_without_a_plan_the_worse_the_dearer(rank, worse_and_worse):
    setups = [with_parameters(SETUP, values) for values in worse_and_worse]
    costs = [_cost(setup, START, START.thetas_rad, plan_even) for setup in setups]
    assert all(rank[0] <= cost <= rank[1] for cost in costs) and costs == sorted(set(costs))


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: free_bounds(SETUP, ()), "name one or more of center_x_m"),
        (lambda: free_bounds(SETUP, ("circle_radius_m", "circle_radius_m")), "name one or more"),
        (lambda: free_bounds(SETUP, ("radius",)), "'radius' is unknown"),
        (lambda: free_bounds(SETUP, ("center_x_m",), {"center_y_m": (0, 1)}), "'center_y_mm' has bounds but is not"),
        (lambda: free_bounds(SETUP, ("center_x_m",), {"center_x_m": (1, 0)}), "the lower first"),
        (lambda: search_setup(START, FREE, rng=np.random.default_rng(0), evaluations=10), "give at least 96"),
        (lambda: searched(GROUPS["circle"], setup=FOLDED), "out of the plane of flat jaws"),
        (lambda: search_setup(dexterity(SETUP, positions=220), FREE, rng=np.random.default_rng(0)), "multiple of 72"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_a_sentence(call, sentence):
    with pytest.raises(TrocarError, match=sentence):
        call()
