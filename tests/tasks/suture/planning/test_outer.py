import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import PRESETS, Reward, dexterity
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.outer import GRASP, PLACEMENT, PORT, free_bounds, jaws_above_m, outer_search
from trocar.tasks.suture.planning.parameters import with_parameters
from trocar.tasks.suture.planning.rewards import scored

SETUP = PRESETS["default"].setup
FEW = {"positions": 72, "coarse": 36, "evaluations": 240}


@pytest.fixture(scope="module")
def found():
    done = []
    search = outer_search(
        SETUP, free=(*PLACEMENT, *GRASP), rng=np.random.default_rng(0), progress=lambda *now: done.append(now), **FEW
    )
    assert done[-1] == (240, 240)
    return search


def test_the_best_setup_found_is_better_feasible_and_holdable_and_has_the_reward_that_it_says(found):
    assert found.plan.reward > found.start_plan.reward + 0.02
    assert found.plan.feasible
    assert found.best.setup.grasp.holdable
    assert jaws_above_m(found.best.setup) >= 0
    again = scored(
        found.best.setup, Reward(), dexterity(found.best.setup, positions=72).joints, scales=found.start.scales
    )
    assert plan_even(again).reward == found.plan.reward
    assert "outer heuristic" in found.certified


def test_numbers_told_make_the_setup_that_was_found_and_lie_within_their_bounds(found):
    free = found.summary()["free"]
    again = with_parameters(SETUP, {name: told["to"] for name, told in free.items()})
    np.testing.assert_allclose(again.T_base_circle.matrix, found.best.setup.T_base_circle.matrix, atol=1e-12)
    assert again.circle.radius_m == pytest.approx(found.best.setup.circle.radius_m)
    assert all(told["low"] - 1e-9 <= told["to"] <= told["high"] + 1e-9 for told in free.values())


def test_the_port_is_read_back_though_the_circle_was_shifted():
    free = (*PLACEMENT, *PORT)
    search = outer_search(SETUP, free=free, rng=np.random.default_rng(2), **FEW)
    again = with_parameters(SETUP, {name: told["to"] for name, told in search.summary()["free"].items()})
    np.testing.assert_allclose(again.T_base_circle.matrix, search.best.setup.T_base_circle.matrix, atol=1e-12)


def test_one_seed_finds_one_setup(found):
    again = outer_search(SETUP, free=(*PLACEMENT, *GRASP), rng=np.random.default_rng(0), **FEW)
    assert again.plan.reward == found.plan.reward


def test_a_search_that_finds_nothing_better_returns_the_start():
    narrow = {"circle_radius_m": (0.0399, 0.04)}
    search = outer_search(SETUP, free=("circle_radius_m",), bounds=narrow, rng=np.random.default_rng(0), **FEW)
    assert search.best is search.start
    assert search.plan.reward == search.start_plan.reward


def test_it_finds_the_best_radius_that_a_fine_scan_finds():
    search = outer_search(SETUP, free=("circle_radius_m",), rng=np.random.default_rng(0), **FEW)
    scales = search.start.scales
    rewards = []
    for radius in np.linspace(0.02, 0.04, 81):
        there = with_parameters(SETUP, {"circle_radius_m": radius})
        rewards.append(plan_even(scored(there, Reward(), dexterity(there, positions=72).joints, scales=scales)).reward)
    assert search.plan.reward >= max(rewards) - 1e-3


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: free_bounds(()), "name one or more of center_x_m"),
        (lambda: free_bounds(("circle_radius_m", "circle_radius_m")), "name one or more"),
        (lambda: free_bounds(("radius",)), "no parameter 'radius'"),
        (lambda: free_bounds(("center_x_m",), {"center_y_m": (0, 1)}), "'center_y_mm', which is not free"),
        (lambda: free_bounds(("center_x_m",), {"center_x_m": (1, 0)}), "the lower first"),
        (lambda: outer_search(SETUP, rng=np.random.default_rng(0), evaluations=10), "give at least 96"),
        (
            lambda: outer_search(PRESETS["paper-demo"].setup, free=PLACEMENT, rng=np.random.default_rng(0)),
            "out of the plane of flat jaws",
        ),
    ],
)
def test_what_cannot_be_searched_is_told_in_a_sentence(call, sentence):
    with pytest.raises(TrocarError, match=sentence):
        call()
