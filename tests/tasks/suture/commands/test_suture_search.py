import numpy as np
import pytest

from trocar.cli import main
from trocar.errors import TrocarError
from trocar.tasks.suture.commands.suture_options import changed_setup
from trocar.tasks.suture.commands.suture_search import Search
from trocar.tasks.suture.planning import PRESETS, Spacing, continuous, dexterity

PARTS = ("base", "needle", "grasp", "insertion")


def large_circle(positions):
    """Return a map of a circle whose far side is out of reach."""
    setup = changed_setup(PRESETS["default"], circle={"radius_m": 0.09}, **{part: {} for part in PARTS})
    found = dexterity(setup, positions=positions)
    assert 0 < found.feasible.mean() < 1
    return found


@pytest.fixture(scope="module")
def partly_out_of_reach():
    return large_circle(360)


def test_where_no_plan_at_any_angles_is_feasible_the_grid_is_shown_and_said_to_be(partly_out_of_reach):
    plan = Search(12, None, continuous=True).plan(partly_out_of_reach, None)[0]
    assert not plan.feasible
    assert plan.certified.startswith("at any angles no feasible plan exists; on the grid, shown here: no plan on the")


def test_what_is_not_proven_is_not_said_to_be(monkeypatch):
    monkeypatch.setattr(continuous, "MAX_CELLS", 10)  # no bisection: arcs that may be feasible stay so
    plan = Search(12, None, continuous=True).plan(large_circle(24), None)[0]
    assert not plan.feasible
    assert plan.certified.startswith("at any angles no feasible plan was found, though one may exist; on the grid")


def test_what_the_grid_cannot_show_is_refused_for_any_angles(partly_out_of_reach):
    off_grid = Spacing(np.radians(30), np.radians(30), fixed_rad=(np.radians(10.5),))
    with pytest.raises(TrocarError, match="no 12 sutures within the joints' limits"):
        Search(12, off_grid, continuous=True).plan(partly_out_of_reach, None)


@pytest.mark.parametrize("continuously", [False, True])
def test_the_bound_of_infeasible_plans_is_of_their_worst_infeasible_suture(partly_out_of_reach, continuously):
    plan = Search(12, None, continuous=continuously).plan(partly_out_of_reach, None)[0]
    can = partly_out_of_reach.at(plan.positions_rad).feasible
    assert plan.bound == pytest.approx(plan.rewards[~can].min()) and plan.reward < plan.bound


def test_the_bound_that_is_printed_is_said_to_be_of_infeasible_sutures(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["trocar", "plan", "suture", "--circle-radius-mm", "90", "--count", "12"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 1
    assert "; bound of worst infeasible sutures 0." in " ".join(capsys.readouterr().out.split())
