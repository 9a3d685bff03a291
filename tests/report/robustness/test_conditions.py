"""The runs of a robustness study."""

import pytest

from trocar.errors import TrocarError
from trocar.eval import TASKS
from trocar.lab.flaws import Difficulty
from trocar.report.robustness.conditions import cells_of, conditions_of

PEG = TASKS.pick("peg-transfer")()


def conditions(tmp_path, difficulty="recorded", **chosen):
    return conditions_of(tmp_path, PEG, difficulty=difficulty, sessions=2, seed=3, **chosen)


def test_the_laboratory_as_it_is_is_run_once_for_each_method(tmp_path):
    found = conditions(tmp_path, methods="uncalibrated,best", flaws="residual,outer", scales="0,1,2")
    assert len(found) == 2 * 2 * 3
    names = [cell.folder.name for cell in cells_of(found)]
    assert names == [
        "uncalibrated-recorded-residual-0",
        "uncalibrated-recorded",
        "uncalibrated-recorded-residual-2",
        "uncalibrated-recorded-outer-0",
        "uncalibrated-recorded-outer-2",
        "best-recorded-residual-0",
        "best-recorded",
        "best-recorded-residual-2",
        "best-recorded-outer-0",
        "best-recorded-outer-2",
    ]


@pytest.mark.parametrize("difficulty", ["mild", "recorded", "harsh"])
def test_one_flaw_is_varied_and_the_others_are_as_they_are(tmp_path, difficulty):
    usual = Difficulty.of(difficulty)
    for condition in conditions(tmp_path, difficulty, methods="uncalibrated", scales="0,1,4"):
        sizes = condition.cell.config.laboratory.difficulty
        assert sizes.scale(condition.flaw) == pytest.approx(condition.scale, rel=1e-5)
        for other in set(usual.values) - {condition.flaw}:
            assert (sizes[other] == usual[other]).all()


def test_sizes_have_the_unit_of_their_flaw(tmp_path):
    found = {c.flaw: c for c in conditions(tmp_path, methods="best", flaws="registration,residual,wear", scales="2")}
    assert (found["registration"].size, found["registration"].unit) == (pytest.approx(0.4), "mm")
    assert (found["residual"].size, found["residual"].unit) == (pytest.approx(1.806, rel=1e-3), "deg")
    assert (found["wear"].size, found["wear"].unit) == (pytest.approx(2.0), "x")


def test_a_station_has_the_flaws_that_it_feels(tmp_path):
    ravens = conditions_of(tmp_path, TASKS.pick("debridement")(), methods="best", difficulty="recorded")
    assert {c.flaw for c in ravens} == {"kinematics", "tool", "jaw"}
    assert "kinematics" not in {c.flaw for c in conditions(tmp_path)}


@pytest.mark.parametrize(
    ("chosen", "what"),
    [
        ({"flaws": "wind"}, "--flaws names 'wind'"),
        ({"methods": "magic"}, "--methods names 'magic'"),
        ({"scales": "0,many"}, "--scales '0,many'"),
        ({"scales": "-1"}, "--scales '-1'"),
        ({"scales": "nan"}, "--scales 'nan'"),
        ({"difficulty": "easy"}, "difficulty 'easy'"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, chosen, what):
    with pytest.raises(TrocarError, match=what):
        conditions(tmp_path, **chosen)
