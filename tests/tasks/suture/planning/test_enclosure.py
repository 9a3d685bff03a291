from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN
from trocar.tasks.suture.planning import (
    MARGINS,
    PRESETS,
    DexterityEnclosure,
    Reward,
    SutureSetup,
    dexterity,
    interpolated_bounds,
)
from trocar.tasks.suture.planning.interval import Interval

seeds = st.integers(0, 2**32 - 1)
FINE = 100
REWARDS = [
    Reward(margin, weight=weight, scaling=scaling, at=at, feasible_first=first, joints=joints)
    for margin in MARGINS
    for weight, scaling, at, first, joints in (
        (0.75, "max", "path", True, "wrist"),
        (0.3, "range", "stations", False, "all" if margin in ("smallest", "normalised") else "wrist"),
    )
]


def check(found, cells, finer):
    """Compare the bounds over even cells with sutures ``finer`` times as dense; return bounds and fine values."""
    edges = np.linspace(0, TURN, cells + 1)
    bounds = DexterityEnclosure(found).over(edges[:-1], edges[1:])
    part = np.linspace(0, 1, finer)
    thetas = (edges[:-1, None] + part * (edges[1:] - edges[:-1])[:, None]).ravel()
    fine = found.at(thetas)
    values = fine.values.reshape(2, cells, finer)
    assert np.all(values.max(2) <= bounds.upper)
    if found.reward.margin != "paper":  # the only formula that is not monotone
        assert np.all(values.min(2) >= bounds.lower)
    feasible = fine.joints.feasible.reshape(2, cells, finer)
    assert np.all(bounds.possible | ~feasible.any(2)) and np.all(feasible.all(2) | ~bounds.certain)
    return bounds, values


@pytest.mark.parametrize("name", PRESETS)
def test_the_bounds_hold_a_grid_a_hundred_times_finer_and_are_tight(name):
    found = dexterity(PRESETS[name].setup, PRESETS[name].reward)
    bounds, values = check(found, 360, FINE)
    assert np.max(bounds.upper - values.max(2)) < 0.08 and np.median(bounds.upper - values.max(2)) < 0.04
    edges = np.linspace(1.0, 1.0 + 1e-4, 101)  # and they close in with the arc
    small = DexterityEnclosure(found).over(edges[:-1], edges[1:])
    assert np.max(small.upper - small.lower) < 1e-4


@pytest.mark.parametrize("reward", REWARDS, ids=lambda reward: f"{reward.margin}-{reward.at}-{reward.joints}")
def test_every_reward_is_enclosed(reward):
    check(dexterity(PRESETS["paper-demo"].setup, reward), 90, 30)


def anywhere(arm, seed):
    """Return a setup with the circle anywhere and turned anyhow, in front of the arm or out of its reach."""
    rng = np.random.default_rng(seed)
    circle = SE3.from_parts(SO3.exp(rng.normal(0, 1.5, 3)), rng.normal([0, 0, 0.0], 0.08))
    setup = replace(PRESETS["default"].setup, arm=arm)
    return replace(setup, circle=replace(setup.circle, T_world_circle=circle))


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
@settings(max_examples=12)
@given(seed=seeds)
def test_any_setup_of_any_arm_is_enclosed_even_where_there_is_no_solution(arm, seed):
    with np.errstate(all="ignore"):
        found = dexterity(anywhere(arm, seed))
    check(found, 60, 12)


def test_joints_are_enclosed_in_one_of_their_windings():
    found = dexterity(PRESETS["paper-demo"].setup)
    edges = np.linspace(0, TURN, 721)
    with np.errstate(all="ignore"):
        ranges = DexterityEnclosure(found).joints(Interval(edges[:-1], edges[1:]))
    q = np.moveaxis(found.at((edges[:-1] + edges[1:]) / 2).joints.q, 1, 2)  # (2, k, c, 6)
    for i, joint in enumerate(ranges.q):
        inside = (joint.low <= q[..., i]) & (q[..., i] <= joint.high)
        if i == 3:
            inside |= (ranges.other_roll.low <= q[..., i]) & (q[..., i] <= ranges.other_roll.high)
        assert inside.all(), i
        assert np.median(joint.width) < 0.1


@given(seed=seeds)
def test_given_manipulability_is_enclosed(seed):
    rng = np.random.default_rng(seed)
    places, values = rng.uniform(-7, 7, 8), rng.random(8)
    start = rng.uniform(0, TURN, 50)
    end = start + rng.uniform(0, 2.0, 50)
    low, high = interpolated_bounds(places, values)(start, end)
    dense = np.interp(np.linspace(start, end, 500), places, values, period=TURN)
    assert np.all(low <= dense.min(0) + 1e-12) and np.all(dense.max(0) <= high + 1e-12)
    inner = np.mod(places[:, None] - start, TURN) < end - start
    exact = np.where(inner, values[:, None], -1).max(0)
    np.testing.assert_allclose(high, np.maximum(exact, np.maximum(dense[0], dense[-1])), atol=1e-12)


def test_manipulability_that_was_given_needs_its_bounds():
    places, values = np.linspace(0, TURN, 8, endpoint=False), np.linspace(1.0, 2.0, 8)
    found = dexterity(
        PRESETS["default"].setup, manipulability_at=lambda theta: np.interp(theta, places, values, period=TURN)
    )
    with pytest.raises(TrocarError, match="manipulability_bounds"):
        DexterityEnclosure(found)
    edges = np.linspace(0, TURN, 91)
    bounds = DexterityEnclosure(found, interpolated_bounds(places, values)).over(edges[:-1], edges[1:])
    fine = found.at(np.linspace(edges[:-1], edges[1:], 20).ravel()).values.reshape(2, 20, 90)
    assert np.all(fine.max(1) <= bounds.upper) and np.all(fine.min(1) >= bounds.lower)


@given(seed=seeds)
@pytest.mark.parametrize("name", MARGINS)
def test_margins_are_largest_at_a_corner_of_a_box(name, seed):
    rng = np.random.default_rng(seed)
    limit, ends = rng.uniform(0.1, 5, 3), np.sort(rng.uniform(0, 7, (2, 3)), axis=0)
    corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), -1)
    inside = rng.uniform(*ends, (200, 3))
    assert MARGINS[name](limit, inside).max() <= MARGINS[name](limit, corners).max() * (1 + 1e-12) + 1e-12


def test_a_setup_out_of_reach_has_no_possible_suture():
    far = replace(SutureSetup(), T_world_base=SE3.from_parts(None, [0.0, 0.0, 0.5]))
    with np.errstate(all="ignore"):
        found = dexterity(far)
    bounds, _ = check(found, 60, 10)
    assert not bounds.possible.any()
