"""Of plans for two arms, it is the best one whose needles the second arm can all pull through."""

from functools import partial

import numpy as np
import pytest

from trocar.errors import OutOfReach
from trocar.lab import load_station
from trocar.tasks.suture.planning import PRESETS, plan_even, two_arms
from trocar.tasks.suture.planning.summary import circle_out_of_reach
from trocar.tasks.suture.variants import pair_of

PAIR = pair_of(load_station("suture-pair"))
POSITIONS, COUNT = 24, 4


def planned(monkeypatch, can, preset="paper-demo"):
    """Return map and plan if the second arm can pull exactly these sutures (2, n) through."""

    def pull(suture, *_):
        if not can[suture.row, round(suture.theta_rad * POSITIONS / (2 * np.pi))]:
            raise OutOfReach("no")

    monkeypatch.setattr(two_arms, "plan_pull", pull)
    return two_arms.plan_pulled(PRESETS[preset], partial(plan_even, count=COUNT), POSITIONS, *PAIR)


@pytest.mark.parametrize("seed", range(12))
def test_no_plan_that_can_be_pulled_through_is_better(monkeypatch, seed):
    can = np.random.default_rng(seed).uniform(size=(2, POSITIONS)) < 0.7
    map, plan = planned(monkeypatch, can)
    usual, _ = planned(monkeypatch, np.ones_like(can))
    np.testing.assert_array_equal(map.values, usual.values)  # what is forbidden changes no rewards
    values = np.where(usual.joints.feasible & can, usual.values, -np.inf).max(0)
    best = values.reshape(COUNT, -1).min(0).max()
    assert plan.feasible == np.isfinite(best)
    if plan.feasible:
        assert plan.reward == plan.bound == best


def test_a_second_arm_that_can_pull_nothing_is_the_reason(monkeypatch):
    map, plan = planned(monkeypatch, np.zeros((2, POSITIONS), dtype=bool), "default")
    assert not plan.feasible
    assert "the second arm cannot pull the needle through" in circle_out_of_reach(map.joints)
