import itertools
from dataclasses import replace
from functools import cache
from math import isinf, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import PSM_CLASSIC
from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning import (
    DIRECTIONS,
    PRESETS,
    Circle,
    DexterityMap,
    Insertion,
    Reward,
    Spacing,
    SutureJoints,
    SutureSetup,
    dexterity,
    grid,
    plan_even,
    plan_gaps,
    refined,
)
from trocar.tasks.suture.planning.grid import ranks

CASES = 200
SEEDS = st.integers(0, 2**32 - 1)
ANGLES = st.floats(-10, 10)


def made_up_map(values, feasible=None, feasible_first=True):
    """Return a map with these values (2, n); where ``feasible`` (2, n) is false, the insertion exceeds its range."""
    values = np.asarray(values, dtype=float)
    n = values.shape[1]
    q = np.broadcast_to(PSM_CLASSIC.middle, (2, n, 1, 6)).copy()
    feasible = np.ones((2, n), dtype=bool) if feasible is None else np.asarray(feasible)
    q[~feasible, 0, 2] = PSM_CLASSIC.upper[2] + 0.01
    joints = SutureJoints(SutureSetup(), 2 * np.pi / n * np.arange(n), q, np.array([True]), *np.ones((3, 2, n)))
    reward = replace(Reward(), feasible_first=feasible_first)
    choice = np.argmax(values - 1e9 * ~feasible if feasible_first else values, axis=0)
    by_arm = np.zeros((2, n))
    return DexterityMap(joints.setup, reward, joints, values, by_arm, by_arm[0], values, choice, (1.0, 1.0))


# Evenly spaced sutures.


def enumerated(found, count):
    """Return the rank of the worst suture of the best even plan, by trying all of them (paper, III-H)."""
    every = ranks(found).reshape(2, count, -1)
    combinations = itertools.product((0, 1), repeat=count)
    return max(int(every[np.array(choice), np.arange(count)].min(0).max()) for choice in combinations)


def worst_rank(found, plan):
    rows = [DIRECTIONS.index(direction) for direction in plan.directions]
    where = np.rint(plan.positions_rad / TURN * len(found.thetas_rad)).astype(int)
    return int(ranks(found)[rows, where].min())


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 8])
def test_no_even_plan_in_any_directions_is_better_on_presets(name, count):
    found = dexterity(PRESETS[name].setup, PRESETS[name].reward)
    assert worst_rank(found, plan_even(found, count)) == enumerated(found, count)


@given(seed=SEEDS)
def test_no_even_plan_is_better_where_many_sutures_tie_and_some_are_infeasible(seed):
    rng = np.random.default_rng(seed)
    count, starts = int(rng.integers(1, 6)), int(rng.integers(1, 8))
    values = rng.integers(0, 4, (2, count * starts)) / 4
    feasible = rng.random(values.shape) < rng.random()
    for first in (True, False):
        found = made_up_map(values, feasible, first)
        plan = plan_even(found, count)
        assert worst_rank(found, plan) == enumerated(found, count)
        assert plan.gaps_rad == pytest.approx(TURN / count)
        assert plan.bound == plan.reward or (first and not plan.feasible)


def test_directions_are_those_of_the_map_whatever_the_weight():
    for weight in (0.0, 0.75, 1.0):
        found = dexterity(PRESETS["paper-demo"].setup, Reward("clipped", weight=weight, feasible_first=False))
        plan = plan_even(found)
        where = np.rint(np.degrees(plan.positions_rad)).astype(int)
        np.testing.assert_array_equal(plan.directions, found.directions[where])


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


# Bounded gaps, arcs, fixed positions.


def random_case(seed):
    """Return a small problem: map, count, spacing."""
    rng = np.random.default_rng(seed)
    positions, count = int(rng.integers(6, 17)), int(rng.integers(1, 6))
    values = rng.integers(0, 12, (2, positions)) / 12 if rng.random() < 0.5 else rng.random((2, positions))
    feasible = rng.random((2, positions)) < rng.choice([0.6, 0.95, 1.0])
    step = TURN / positions
    even = positions / count
    min_gap = step * min(positions, max(0.3, even - rng.integers(0, 4)))
    max_gap = min(TURN, max(min_gap, step * (even + rng.integers(0, 4))))
    arcs = tuple((start, start + rng.uniform(0.05, 1.5)) for start in rng.uniform(0, TURN, rng.integers(0, 3)))
    fixed = tuple(step * rng.choice(positions, rng.integers(0, 3), replace=False)) if rng.random() < 0.4 else ()
    found = made_up_map(values, feasible, bool(rng.integers(2)))
    return found, count, Spacing(min_gap, max_gap, arcs, fixed)


def in_a_forbidden_arc(theta, arcs):
    return any(
        start + 1e-9 < theta + k * TURN < start + (end - start) % TURN - 1e-9 for start, end in arcs for k in (0, 1)
    )


def brute_force(found, count, spacing):
    """Return (feasible, reward) of the best plan by trying every set of positions; None if there is none."""
    n, best, feasible = len(found.thetas_rad), None, found.joints.feasible
    for where in itertools.combinations(range(n), count):
        thetas = TURN / n * np.array(where)
        gaps = np.diff(thetas, append=thetas[0] + TURN)
        if gaps.min() < spacing.min_gap_rad - 1e-7 or gaps.max() > spacing.max_gap_rad + 1e-7:
            continue
        if any(in_a_forbidden_arc(theta, spacing.forbidden_rad) for theta in thetas):
            continue
        if any(np.abs(thetas - fixed).min() > 1e-7 for fixed in spacing.fixed_rad):
            continue
        sutures = []
        for k in where:
            rows = sorted((bool(feasible[r, k]) and found.reward.feasible_first, found.values[r, k]) for r in (0, 1))
            sutures.append(rows[-1])
        first, reward = min(sutures)
        best = max(best or (False, -np.inf), (bool(first), reward))
    return best


def test_agrees_with_brute_force_on_small_random_cases():
    solved = 0
    for seed in range(CASES):
        found, count, spacing = random_case(seed)
        try:
            wanted = brute_force(found, count, spacing)
            plan = plan_gaps(found, count, spacing)
        except TrocarError:
            assert wanted is None, f"case {seed}"
            continue
        assert wanted is not None, f"case {seed}"
        solved += 1
        first, reward = wanted
        assert plan.bound == reward, f"case {seed}"
        if found.reward.feasible_first:
            assert plan.feasible == first
        if plan.feasible or not found.reward.feasible_first:
            assert plan.reward == plan.bound
        # and the plan is what it says
        assert len(plan.positions_rad) == count and np.all(np.diff(plan.positions_rad) > 0)
        assert plan.gaps_rad.min() >= spacing.min_gap_rad - 1e-7 and plan.gaps_rad.sum() == pytest.approx(TURN)
        assert plan.gaps_rad.max() <= spacing.max_gap_rad + 1e-7
        assert not any(in_a_forbidden_arc(theta, spacing.forbidden_rad) for theta in plan.positions_rad)
        for fixed in spacing.fixed_rad:
            assert np.abs(plan.positions_rad - fixed).min() < 1e-9
    assert solved > CASES / 2


def test_of_plans_with_the_same_worst_suture_the_largest_sum_is_taken():
    values = np.random.default_rng(5).integers(0, 5, (2, 12)) / 4
    found, spacing = made_up_map(values), Spacing(TURN / 6, TURN / 3)
    plan = plan_gaps(found, 4, spacing)
    best = values.max(0)
    sums = [
        best[list(where)].sum()
        for where in itertools.combinations(range(12), 4)
        if all(2 <= gap <= 4 for gap in np.diff(where, append=where[0] + 12)) and best[list(where)].min() == plan.reward
    ]
    assert plan.rewards.sum() == max(sums) > min(sums)


@pytest.mark.parametrize("name", PRESETS)
def test_even_gaps_are_the_papers_problem_and_free_ones_are_no_worse(name):
    found = mapped(name)
    for count in (3, 4, 6):
        even = plan_even(found, count)
        assert plan_gaps(found, count, Spacing.even(count)).reward == even.reward
        rewards = [plan_gaps(found, count, Spacing(TURN / count - g, TURN / count + g)).reward for g in (0, 0.1, 0.3)]
        assert even.reward == rewards[0] <= rewards[1] <= rewards[2]


@pytest.mark.parametrize(
    ("count", "spacing", "sentence"),
    [
        (4, Spacing(radians(60), radians(80)), "4 gaps of 60 to 80 deg add up to 240 to 320 deg, not to 360.*90"),
        (7, Spacing.even(7), "7 sutures .* of the grid's 360 steps cannot close"),
        (4, Spacing(1, 2, fixed_rad=(radians(10.5),)), "fixed position 10.5 deg is not on the grid of 360 positions"),
        (2, Spacing(1, 6, fixed_rad=(0.0, radians(60), radians(90))), "3 positions are fixed, but only 2 sutures"),
        (4, Spacing(1, 2, ((0.5, 1.5),), (radians(60),)), "fixed position 60 deg lies in a forbidden arc"),
        (4, Spacing(1, 2, ((0.0, 2.1),)), r"no 4 sutures .* forbidden arcs \(0 to 120.321 deg\)"),
        (4, Spacing(1, 2, fixed_rad=(0.0, radians(30))), r"no 4 sutures .* fixed positions \(0, 30 deg\)"),
        (0, Spacing(1, 2), "number of sutures is 0"),
    ],
)
def test_what_cannot_be_met_is_refused_in_a_sentence(count, spacing, sentence):
    with pytest.raises(TrocarError, match=sentence):
        plan_gaps(mapped(), count, spacing)


def test_bounds_on_the_entries_are_refused_for_they_bound_no_gap_in_the_tissue():
    demo = dexterity(PRESETS["paper-demo"].setup, positions=36)
    with pytest.raises(TrocarError, match=r"where needles enter, half a bite .* let theta_is be middle"):
        plan_gaps(demo, 4, Spacing.even(4))


@given(start=ANGLES, length=st.floats(0.01, 6.2), theta=ANGLES)
def test_forbidden_arcs_wrap(start, length, theta):
    into = (theta - start) % TURN
    if min(abs(into), abs(into - length), abs(into - TURN)) < 1e-6:
        return
    spacing = Spacing(1, 2, ((start, start + length),))
    assert spacing.allows([theta])[0] == (into > length)


def test_the_ends_of_arcs_are_allowed():
    assert Spacing(1, 2, ((6.0, 0.5),)).allows([6.0, 0.5, 6.1, 0.0, 0.4, 3.0]).tolist() == [1, 1, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((2, 1), "114.592 deg and 57.2958 deg; give a smallest gap"),
        ((0, 1), "above 0"),
        ((1, np.nan), "gaps between sutures"),
        ((1, 7), "at most 360"),
        ((1, 2, ((1, 1),)), "must differ"),
        ((1, 2, ((1, np.inf),)), "forbidden arc in rad"),
        ((1, 2, ((1, 2, 3),)), "forbidden arc in rad"),
        ((1, 2, (), ("a",)), "fixed positions in rad"),
        ((1, 2, (), 3.0), "fixed positions in rad"),
    ],
)
def test_bad_spacings_are_refused(arguments, sentence):
    with pytest.raises(TrocarError, match=sentence):
        Spacing(*arguments)


# Any angles.

FINER = 100
FIXED_RAD = tuple(np.radians([60, 200]))
EVEN, FREE = Spacing.even(4), Spacing(radians(75), radians(105))
PROBLEMS = {
    "even": (4, EVEN),
    "free": (4, FREE),
    "many": (12, Spacing(radians(20), radians(40))),
    "bounded": (5, Spacing(radians(50), radians(100), ((radians(350.2), radians(20.7)),), FIXED_RAD)),
}
FINE = {
    "default": {"even": 0.61927, "free": 0.65597, "many": 0.52872, "bounded": 0.56866},
    "paper-demo": {"even": 0.62546, "free": 0.64067, "many": 0.53041, "bounded": 0.48824},
}
"""Rewards of the best plans on grids ten (``even``: a hundred) times finer, found by dynamic programming."""


@cache
def mapped(name="default"):
    """Return the map of a preset, theta in the middle of the bites."""
    setup = PRESETS[name].setup
    return dexterity(replace(setup, insertion=Insertion()), PRESETS[name].reward)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", PRESETS)
def test_any_angles_are_no_worse_than_the_grid_meet_the_spacing_and_have_the_rewards_that_they_say(name, problem):
    (count, spacing), map = PROBLEMS[problem], mapped(name)
    on_grid = plan_gaps(map, count, spacing)
    plan = refined(map, on_grid, spacing)
    assert plan.reward >= on_grid.reward and plan.feasible == on_grid.feasible
    assert plan.gaps_rad.min() > spacing.min_gap_rad - 1e-6 and plan.gaps_rad.max() < spacing.max_gap_rad + 1e-6
    assert spacing.allows(plan.positions_rad).all()
    for place in spacing.fixed_rad:
        assert np.abs(plan.positions_rad - place).min() < 1e-6
    again = map.at(plan.positions_rad)
    np.testing.assert_allclose(plan.rewards, again.best, rtol=0, atol=1e-12)
    assert FINE[name][problem] - 1e-5 < plan.reward < FINE[name][problem] + 4e-4
    assert isinf(plan.bound) and "nothing is proven" in plan.certified


def test_even_plans_are_as_good_as_those_of_a_grid_a_hundred_times_finer():
    map = mapped()
    fine = plan_even(map.at(TURN / (360 * FINER) * np.arange(360 * FINER)))
    plan = refined(map, plan_even(map), EVEN)
    assert plan.reward > plan_even(map).reward + 1e-4, "what whole degrees give away"
    assert plan.reward >= fine.reward - 1e-6


def test_a_plan_is_refined_too_where_a_finer_grid_would_be_too_large(monkeypatch):
    map = mapped()
    on_grid, best = plan_even(map), refined(map, plan_even(map), EVEN)
    monkeypatch.setattr(grid, "MOST_POSITIONS", 360)
    assert on_grid.reward < refined(map, on_grid, EVEN).reward < best.reward, "the nearest hill is not the highest"


def test_the_worst_infeasible_suture_counts_as_on_the_grid():
    far = dexterity(replace(PRESETS["default"].setup, circle=Circle(0.090)), Reward(), 72)
    on_grid = plan_gaps(far, 12, Spacing.even(12))
    plan = refined(far, on_grid, Spacing.even(12))
    assert not on_grid.feasible and not plan.feasible
    worst = [found.rewards[~far.at(found.positions_rad).feasible].min() for found in (on_grid, plan)]
    assert worst[1] >= worst[0]
