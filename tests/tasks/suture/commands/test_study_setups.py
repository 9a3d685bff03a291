"""``trocar study suture-setup`` prints, draws and saves the maps of arms and needles."""

import json
from functools import partial

import matplotlib.image
import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.files.output import mark_of
from trocar.tasks.suture.commands import STUDY_SETUPS
from trocar.tasks.suture.commands.study_setups import KIND, setups
from trocar.tasks.suture.planning import setup_map as module


@pytest.fixture
def few(monkeypatch):
    """Make maps of one place."""
    of_place = partial(module.setup_map, sideways_m=np.array([0.05]), up_m=np.array([0.1]))
    monkeypatch.setattr(module, "setup_map", of_place)


def test_the_largest_circles_are_printed_drawn_and_saved_with_where_to_plan_them(few, trocar, tmp_path, capsys):
    found = setups(arm=["psm-classic", "raven2-left"], needle=["SH", "PS-2"], out=tmp_path / "maps")
    found.show(as_json=False)
    text = " ".join(capsys.readouterr().out.split())
    assert "psm-classic │ SH │ 1 of 1 │ 80" in text and "raven2-left │ PS-2 │ 0 of 1 │ -" in text
    saved = json.loads((tmp_path / "maps" / "summary.json").read_text())
    assert saved["made_by"] == mark_of(KIND)
    assert saved["maps"] == list(found.summary["maps"]) and len(saved["maps"]) == 4
    assert matplotlib.image.imread(tmp_path / "maps" / "suture_setups.png")[..., :3].std() > 0.05
    command = saved["maps"][0]["command"]
    assert f"to plan there: {command}" in text
    code, out, _ = trocar(*command.removeprefix("trocar ").split(), "--json")
    planned = json.loads(out)
    assert code == 0 and planned["unreachable_deg"] == []
    assert planned["setup"]["circle"]["radius_m"] == pytest.approx(0.08)
    assert saved["maps"][1]["command"] is None


@pytest.mark.parametrize(
    ("given", "words"), [({"arm": ["psm"]}, "the arm 'psm'"), ({"needle": ["X"]}, "the needle 'X'")]
)
def test_unknown_names_are_refused_with_the_choices(given, words, tmp_path):
    with pytest.raises(TrocarError, match=f"{words} is unknown; .*choose one of"):
        setups(**given, out=tmp_path / "maps")
    assert not (tmp_path / "maps").exists()


def test_its_line_for_the_help_names_the_function():
    assert STUDY_SETUPS.where == f"{setups.__module__}:{setups.__name__}"
