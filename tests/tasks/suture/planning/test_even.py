import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_up_map import made_up_map
from trocar.errors import TrocarError
from trocar.tasks.suture.planning import DIRECTIONS, PRESETS, Reward, dexterity, plan_even, plan_exhaustive

seeds = st.integers(0, 2**32 - 1)


def same(one, other):
    np.testing.assert_array_equal(one.positions_rad, other.positions_rad)
    np.testing.assert_array_equal(one.directions, other.directions)
    np.testing.assert_array_equal(one.rewards, other.rewards)
    assert (one.feasible, one.bound) == (other.feasible, other.bound)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 8])
def test_the_fast_search_and_full_enumeration_agree_on_presets(name, count):
    found = dexterity(PRESETS[name].setup, PRESETS[name].reward)
    same(plan_even(found, count), plan_exhaustive(found, count))


@given(seed=seeds)
def test_they_agree_where_many_sutures_tie_and_some_are_infeasible(seed):
    rng = np.random.default_rng(seed)
    count, starts = rng.integers(1, 6), rng.integers(1, 8)
    values = rng.integers(0, 4, (2, count * starts)) / 4
    feasible = rng.random(values.shape) < rng.random()
    for first in (True, False):
        found = made_up_map(values, feasible, first)
        same(plan_even(found, int(count)), plan_exhaustive(found, int(count)))


def test_directions_are_those_of_the_map_whatever_the_weight():
    for weight in (0.0, 0.75, 1.0):
        found = dexterity(PRESETS["paper-demo"].setup, Reward("clipped", weight=weight, feasible_first=False))
        plan = plan_even(found)
        where = np.rint(np.degrees(plan.positions_rad)).astype(int)
        np.testing.assert_array_equal(plan.directions, found.directions[where])


@given(seed=seeds)
def test_no_start_is_better(seed):
    values = np.random.default_rng(seed).normal(size=(2, 60))
    plan = plan_even(made_up_map(values), 4)
    starts = [values.max(0)[start::15].min() for start in range(15)]
    assert plan.reward == plan.bound == max(starts)
    assert plan.positions_rad[0] == pytest.approx(2 * np.pi / 60 * np.argmax(starts))
    assert plan.gaps_rad == pytest.approx(np.full(4, np.pi / 2))


def test_a_feasible_plan_beats_a_better_one_that_is_not():
    values, feasible = np.full((2, 8), 0.2), np.ones((2, 8), dtype=bool)
    values[:, 1::2], feasible[:, 3] = 0.9, False
    plan = plan_even(made_up_map(values, feasible), 4)
    assert plan.feasible and plan.reward == 0.2
    assert "no plan on the grid of 8 positions" in plan.certified
    plan = plan_even(made_up_map(values, feasible, feasible_first=False), 4)
    assert not plan.feasible and plan.reward == 0.9
    assert "within the joints' limits or not" in plan.certified


def test_a_feasible_direction_beats_a_better_one_that_is_not():
    values, feasible = np.array([[0.9] * 4, [0.3] * 4]), np.array([[False] * 4, [True] * 4])
    assert plan_even(made_up_map(values, feasible)).directions.tolist() == [DIRECTIONS[1]] * 4


def test_of_infeasible_plans_the_worst_infeasible_suture_counts():
    values, feasible = np.full((2, 8), 0.5), np.ones((2, 8), dtype=bool)
    feasible[:, :2] = False
    values[:, 1], values[:, 5] = 0.6, 0.1
    plan = plan_even(made_up_map(values, feasible), 4)
    assert not plan.feasible and plan.positions_rad[0] > 0 and plan.bound == 0.6
    assert "is feasible" in plan.certified


def test_positions_that_cannot_be_divided_are_refused():
    found = dexterity(PRESETS["paper-demo"].setup, positions=90)
    with pytest.raises(TrocarError, match=r"90 positions .* 4 sutures; give a multiple, such as 92"):
        plan_even(found, 4)
    for count in (0, -3, 2.5, 361):
        with pytest.raises(TrocarError, match="number of sutures"):
            plan_even(found, count)
    with pytest.raises(TrocarError, match="enumerate at most"):
        plan_exhaustive(found, 30)
