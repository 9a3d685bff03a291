from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.tasks.suture.planning import PRESETS, Reward, dexterity, suture_joints
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.outer import PLACEMENT, outer_search
from trocar.tasks.suture.planning.outer_bound import bound_of_ball, certified_search
from trocar.tasks.suture.planning.parameters import with_parameters
from trocar.tasks.suture.planning.random_setups import random_setup
from trocar.tasks.suture.planning.rewards import scored

SETUP = PRESETS["default"].setup
NARROW = {"center_x_m": (-0.003, 0.003), "center_y_m": (-0.003, 0.003), "circle_radius_m": (0.028, 0.032)}


def shifted(here, x_m, y_m, radius_m):
    setup = here.setup
    values = {"center_x_m": x_m, "center_y_m": y_m, "circle_radius_m": setup.circle.radius_m + radius_m}
    there = with_parameters(setup, values)
    return scored(there, here.reward, suture_joints(there, here.thetas_rad), scales=here.scales)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    exponent=st.floats(-5, -2),
    margin=st.sampled_from(["smallest", "normalised", "clipped"]),
    at=st.sampled_from(["path", "stations"]),
)
def test_no_circle_on_the_ball_does_better_than_its_bound(seed, exponent, margin, at):
    rng = np.random.default_rng(seed)
    shift = 10**exponent
    here = dexterity(random_setup(rng), Reward(margin=margin, at=at, weight=rng.uniform()), 24)
    bound = bound_of_ball(here, shift)
    for _ in range(4):
        outward = rng.uniform(0, 1) * shift
        angle = rng.uniform(0, 2 * np.pi)
        x, y = (shift - outward) * np.array([np.cos(angle), np.sin(angle)])
        there = shifted(here, x, y, outward)
        assert np.all(there.values <= bound.values + 1e-9)
        assert np.all(there.margin <= bound.margin + 1e-9)
        assert np.all(there.manipulability <= bound.manipulability * (1 + 1e-9))
        assert np.all(bound.joints.feasible | ~there.joints.feasible)


def test_the_bound_holds_where_the_roll_may_be_wound_the_other_way():
    shift, changed = 2e-3, 0
    for spin in np.radians(np.arange(0, 360, 10)):
        setup = with_parameters(PRESETS["paper-demo"].setup, {"base_spin_rad": spin})
        here = dexterity(setup, Reward(margin="clipped", at="stations", weight=1.0), 36)
        bound = bound_of_ball(here, shift)
        for angle in (0.0, 2.1, 4.2):
            there = shifted(here, shift * np.cos(angle), shift * np.sin(angle), 0.0)
            assert np.all(there.margin <= bound.margin + 1e-9)
            changed += int((np.abs(there.joints.q[..., 3] - here.joints.q[..., 3]).min(2) > np.pi).sum())
    assert changed > 0


def test_the_bound_is_tight_to_first_order():
    here = dexterity(SETUP, positions=24)
    shift = 1e-5
    bound = bound_of_ball(here, shift)
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    gained = (
        np.max([shifted(here, shift * np.cos(t), shift * np.sin(t), 0.0).values for t in turns], axis=0) - here.values
    )
    allowed = bound.values - here.values
    assert np.all(gained <= allowed)
    assert np.median(gained / allowed) > 0.25


def test_what_is_found_and_what_is_proven_meet_and_enclose_a_scan_and_a_search():
    found = certified_search(SETUP, bounds=NARROW, positions=36, gap=0.01)
    assert found.plan.reward <= found.bound <= found.plan.reward + 0.01
    start = dexterity(SETUP, positions=36)
    best = -np.inf
    for x in np.linspace(-0.003, 0.003, 4):
        for y in np.linspace(-0.003, 0.003, 4):
            for radius in np.linspace(0.028, 0.032, 3):
                plan = plan_even(shifted(start, x, y, radius - SETUP.circle.radius_m))
                best = max(best, plan.reward if plan.feasible else -np.inf)
    assert best <= found.bound
    search = outer_search(
        SETUP, free=PLACEMENT, bounds=NARROW, rng=np.random.default_rng(0), positions=36, coarse=36, evaluations=200
    )
    assert search.plan.reward <= found.bound
    assert search.plan.reward >= found.plan.reward - 0.01
    again = dict(zip(found.free, found.values, strict=True))
    np.testing.assert_allclose(
        with_parameters(SETUP, again).T_base_circle.matrix, found.best.setup.T_base_circle.matrix, atol=1e-12
    )


def test_stopping_early_leaves_a_true_bound_and_says_so():
    gaps = []
    early = certified_search(
        SETUP, bounds=NARROW, positions=36, gap=1e-4, max_boxes=20, progress=lambda _, gap: gaps.append(gap)
    )
    assert early.boxes <= 21
    assert gaps == sorted(gaps, reverse=True)
    late = certified_search(SETUP, bounds=NARROW, positions=36, gap=0.01)
    assert early.bound >= late.plan.reward
    assert f"{early.bound:.4f}" in early.certified


def test_where_no_circle_has_a_feasible_plan_that_is_proven():
    far = {"center_x_m": (-0.12, -0.10)}
    found = certified_search(SETUP, free=("center_x_m",), bounds=far, positions=36, max_boxes=100)
    assert found.bound == -np.inf
    assert "no circle within the bounds has a feasible plan" in found.certified


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: certified_search(SETUP, free=("base_up_m",)), "no bound is known while base_up_m is free"),
        (lambda: certified_search(SETUP, Reward(margin="paper")), "no bound is known for the margin 'paper'"),
        (lambda: certified_search(replace(SETUP, arm=ARMS["raven2-left"])), "do not meet at right angles"),
        (lambda: certified_search(SETUP, gap=0.0), "give a number above 0"),
        (lambda: certified_search(SETUP, bounds={"circle_radius_m": (0.01, 0.03)}), "too small for a needle"),
    ],
)
def test_what_cannot_be_proven_is_told_in_a_sentence(call, sentence):
    with pytest.raises(TrocarError, match=sentence):
        call()
