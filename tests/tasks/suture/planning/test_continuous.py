from dataclasses import replace
from functools import cache
from math import inf, radians

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning import (
    PRESETS,
    Circle,
    DexterityEnclosure,
    Reward,
    Spacing,
    SutureSetup,
    continuous,
    dexterity,
    interpolated_bounds,
    plan_continuous,
    plan_even,
    plan_gaps,
)
from trocar.tasks.suture.planning.continuous import Cells, NoPlan
from trocar.tasks.suture.planning.gaps import walks_on_grid

FINER = 100
PROBLEMS = [(4, 90, 90), (12, 20, 40)]


@cache
def maps(name, reward=None):
    """Return a map on the paper's grid, and with its scales on one a hundred times finer."""
    found = dexterity(PRESETS[name].setup, reward or PRESETS[name].reward)
    return found, found.at(TURN / (360 * FINER) * np.arange(360 * FINER))


def above(fine, level):
    """Return which positions (n,) exceed a level in the best direction that counts."""
    counts = fine.joints.feasible if fine.reward.feasible_first else np.ones(fine.values.shape, dtype=bool)
    return (np.where(counts, fine.values, -inf) > level).any(0)


def spacing(min_deg, max_deg, **more):
    return Spacing(radians(min_deg), radians(max_deg), **more)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("problem", PROBLEMS, ids=str)
def test_the_bound_holds_a_grid_a_hundred_times_finer_and_is_tight(name, problem):
    found, fine = maps(name)
    count, min_deg, max_deg = problem
    asked = spacing(min_deg, max_deg)
    plan = plan_continuous(found, count, asked)
    assert plan_gaps(found, count, asked).reward <= plan.reward <= plan.bound <= plan.reward + 1e-3
    walks = walks_on_grid(fine, count, asked)
    assert len(walks.closing(above(fine, plan.bound))) == 0
    assert plan.gaps_rad.min() > radians(min_deg) - 1e-9 and plan.gaps_rad.max() < radians(max_deg) + 1e-9
    again = found.at(plan.positions_rad)
    np.testing.assert_allclose(plan.rewards, again.best, rtol=0, atol=1e-12)
    assert plan.feasible and again.feasible.all() and "intervals" in plan.certified


@pytest.mark.parametrize("finest", [0.02, 1e-4])
def test_superlevel_arcs_hold_every_position_that_reaches_the_level(finest):
    found, fine = maps("default")
    forbidden = Spacing(1, 2, ((0.5, 1.2),))
    for level in (0.5, 0.65, 0.8):
        arcs = Cells(DexterityEnclosure(found), forbidden).superlevel_arcs(level, finest)
        inside = np.array([[low <= theta <= high for low, high in arcs] for theta in fine.thetas_rad]).any(1)
        reached = above(fine, level) & forbidden.allows(fine.thetas_rad)
        assert np.all(inside | ~reached) and not np.any(inside & (fine.thetas_rad > 0.51) & (fine.thetas_rad < 1.19))
        assert inside.mean() < reached.mean() + (0.2 if finest > 1e-3 else 1e-3)


def test_a_finer_tolerance_brings_plan_and_bound_together():
    found, fine = maps("default")
    coarse, sharp = (plan_continuous(found, 4, Spacing.even(4), tolerance) for tolerance in (1e-2, 2e-5))
    assert sharp.bound - sharp.reward <= 2e-5
    assert coarse.reward <= sharp.reward + 2e-5 and sharp.bound <= coarse.bound + 2e-5
    assert plan_even(fine, 4).reward <= sharp.bound
    assert sharp.reward > plan_even(found, 4).reward + 1e-4  # what the paper's whole degrees give away


@pytest.mark.parametrize("reward", [Reward("paper", feasible_first=False), Reward("normalised", at="stations")])
def test_other_rewards_are_bounded_too(reward):
    found, fine = maps("paper-demo", reward)
    plan = plan_continuous(found, 5, spacing(60, 85))
    walks = walks_on_grid(fine, 5, spacing(60, 85))
    assert plan.bound <= plan.reward + 1e-3 and len(walks.closing(above(fine, plan.bound))) == 0


def test_arcs_and_fixed_positions_off_the_grid_are_met():
    found, fine = maps("default")
    asked = spacing(50, 100, forbidden_rad=((radians(350.2), radians(20.7)),), fixed_rad=(radians(60.123), 3.5))
    plan = plan_continuous(found, 5, asked)
    for place in asked.fixed_rad:
        assert np.abs(plan.positions_rad - place).min() < 1e-9
    assert asked.allows(plan.positions_rad).all() and plan.bound <= plan.reward + 1e-3
    free = plan_continuous(found, 5, spacing(50, 100))
    assert plan.reward < free.reward
    assert plan.bound <= found.at(asked.fixed_rad).best.min() + 1e-3
    allowed = above(fine, plan.bound) & asked.allows(fine.thetas_rad)
    near = replace(asked, fixed_rad=tuple(np.rint(np.array(asked.fixed_rad) / TURN * 36000) * TURN / 36000))
    fixed = np.rint(np.array(near.fixed_rad) / TURN * 36000).astype(int)
    walks = walks_on_grid(fine, 5, near)  # fixed positions moved onto the fine grid: they alone may exceed the bound
    allowed[fixed] = found.at(asked.fixed_rad).best > plan.bound
    assert len(walks.closing(allowed)) == 0


@pytest.mark.parametrize("weight", [0.05, 0.2])
def test_tension_is_bounded_too(weight):
    found, _ = maps("paper-demo")
    fine = found.at(TURN / 1080 * np.arange(1080))
    asked = spacing(60, 120, tension=weight)
    plan = plan_continuous(found, 4, asked)
    assert plan.tension_cost == pytest.approx(weight * np.abs(plan.gaps_rad / (TURN / 4) - 1).max())
    assert plan_gaps(found, 4, asked).value <= plan.value <= plan.bound <= plan.value + 1e-3
    assert plan.value - 2e-3 < plan_gaps(fine, 4, asked).value <= plan.bound


def test_given_manipulability_is_bounded_by_its_pieces():
    places, values = np.linspace(0, TURN, 8, endpoint=False), np.array([1.0, 3, 2, 1, 2, 2, 1, 3])
    found = dexterity(
        PRESETS["default"].setup, manipulability_at=lambda theta: np.interp(theta, places, values, period=TURN)
    )
    plan = plan_continuous(found, 4, spacing(75, 105), manipulability_bounds=interpolated_bounds(places, values))
    fine = found.at(TURN / 36000 * np.arange(36000))
    walks = walks_on_grid(fine, 4, spacing(75, 105))
    assert plan.bound <= plan.reward + 1e-3 and len(walks.closing(above(fine, plan.bound))) == 0


def test_what_cannot_be_met_is_refused_in_a_sentence():
    found, _ = maps("default")
    with pytest.raises(TrocarError, match="not to 360"):
        plan_continuous(found, 4, spacing(60, 80))
    with pytest.raises(TrocarError, match="no 4 sutures"):
        plan_continuous(found, 4, spacing(60, 120, forbidden_rad=((0.0, radians(125)),)))
    with pytest.raises(TrocarError, match="tolerance"):
        plan_continuous(found, 4, spacing(60, 120), tolerance=float("nan"))
    far = dexterity(replace(SutureSetup(), T_world_base=SE3.from_parts(None, [0.0, 0.0, 0.5])))
    with pytest.raises(TrocarError, match="no 4 sutures within the joints' limits"):
        plan_continuous(far, 4, spacing(60, 120))


def test_none_found_is_not_called_none_unless_proven(monkeypatch):
    far = replace(PRESETS["default"].setup, circle=Circle(0.09))
    with pytest.raises(NoPlan, match="no 12 sutures within the joints' limits have gaps") as refused:
        plan_continuous(dexterity(far), 12, Spacing.even(12))
    assert refused.value.proven
    monkeypatch.setattr(continuous, "MAX_CELLS", 10)  # no bisection: arcs that may be feasible stay so
    with pytest.raises(NoPlan, match="were found for this spacing, though it is not proven") as refused:
        plan_continuous(dexterity(far, positions=16), 12, Spacing.even(12))
    assert not refused.value.proven
