import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import MARGINS
from trocar.tasks.suture.planning.parameters import parameters_of
from trocar.tasks.suture.planning.table_fits import FREE, fit_table_1, table_fits


def test_each_formula_reproduces_the_table_in_some_setup_so_the_table_identifies_none():
    fits = table_fits()
    assert [fit.margin for fit in fits] == list(MARGINS)
    for fit in fits:
        told = fit.summary()
        assert told["largest_difference_points"] < 4
        assert max(told["switches_off_paper_deg"]) < 5
        assert len(told["switches_deg"]) == 2
        assert told["infeasible_positions"] == 0
        assert fit.dexterity.reward.margin == fit.margin


def test_the_setups_that_fit_are_far_from_one_another():
    numbers = np.array([[parameters_of(fit.setup)[name] for name in FREE] for fit in table_fits()])
    spread = {name: float(np.ptp(column)) for name, column in zip(FREE, numbers.T, strict=True)}
    assert spread["grasp_behind_tip_rad"] > np.radians(30)
    assert spread["base_up_m"] > 0.03


def test_a_short_fit_turns_to_the_switches_and_keeps_within_the_limits():
    done = []
    fit = fit_table_1("clipped", seed=1, generations=3, progress=lambda *now: done.append(now))
    told = fit.summary()
    assert told["infeasible_positions"] == 0
    assert told["largest_difference_points"] < 25
    assert max(told["switches_off_paper_deg"]) < 30
    assert done[-1] == (3, 3)


def test_an_unknown_formula_is_told():
    with pytest.raises(TrocarError, match="'largest' is unknown; choose one of smallest"):
        fit_table_1("largest")
