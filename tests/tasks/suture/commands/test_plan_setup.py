import json

import numpy as np
import pytest

from trocar.tasks.suture.commands.plan_setup import as_options
from trocar.tasks.suture.commands.plan_suture import setup_of
from trocar.tasks.suture.planning import PRESETS
from trocar.tasks.suture.planning.setup import SEARCHED, with_parameters


@pytest.fixture
def trocar(trocar):
    return lambda line: trocar(*line.split())


def test_the_search_is_never_worse_than_the_preset_and_says_that_it_proves_nothing(trocar):
    code, out, _ = trocar("plan setup --free port --evaluations 100 --json")
    found = json.loads(out)
    assert code == 0
    assert found["reward"] >= found["start_reward"] == json.loads(trocar("plan suture --json")[1])["reward"]
    assert "proves nothing" in found["certified"]
    for number in found["free"]:
        assert number["low"] <= number["to"] <= number["high"]
        assert number["name"].startswith("base_")
    was = {number["name"]: number["from"] for number in found["free"]}
    assert was == pytest.approx(
        {"base_azimuth_deg": 225, "base_sideways_mm": 50, "base_up_mm": 100, "base_tilt_deg": 40, "base_spin_deg": -135}
    )


def test_a_base_is_found_for_an_arm_that_does_not_reach_from_the_presets(trocar):
    code, out, _ = trocar("plan setup --arm raven2-left --free port --evaluations 500 --json")
    found = json.loads(out)
    assert (code, found["start_feasible"], found["feasible"], found["crossing_deg"]) == (0, False, True, [])
    code, out, _ = trocar(found["command"].removeprefix("trocar ") + " --json")
    again = json.loads(out)
    assert (code, again["arm"], again["feasible"]) == (0, "raven2-left", True)


def test_the_printed_command_keeps_the_gaps_that_were_asked_for(trocar):
    line = "plan setup --free center_x_mm --evaluations 96 --min-gap-deg 80 --max-gap-deg 100 --json"
    found = json.loads(trocar(line)[1])
    assert "--min-gap-deg 80" in found["command"]
    assert np.diff(found["positions_deg"]).min() >= 80 and np.diff(found["positions_deg"]).max() <= 100


def test_the_printed_command_plans_in_the_setup_that_was_found(trocar, tmp_path):
    _, out, _ = trocar(f"plan setup --free circle --free grasp --evaluations 100 --seed 5 --out {tmp_path}/new --json")
    found = json.loads(out)
    assert (tmp_path / "new" / "plan.png").stat().st_size > 10_000
    code, again, _ = trocar(found["command"].removeprefix("trocar ") + " --json")
    assert code == 0, "feasible there too; the reward is scaled anew, so the plan may be another"
    assert json.loads(again)["jaws_can_hold_needle"] is True


def test_every_number_of_a_setup_is_written_as_an_option_that_reads_back():
    preset, rng = PRESETS["default"], np.random.default_rng(3)
    values = {name: rng.uniform(*bounds) for name, bounds in SEARCHED.items()}
    wanted = with_parameters(preset.setup, values)
    texts = dict(text.removeprefix("--").split(maxsplit=1) for text in as_options(wanted, preset.setup))
    center_mm = [float(part) for part in texts.pop("center-mm").split()]
    given = {flag.replace("-", "_"): float(text) for flag, text in texts.items()}
    made = setup_of(preset, None, given | {"center_mm": center_mm})
    np.testing.assert_allclose(made.T_base_circle.matrix, wanted.T_base_circle.matrix, atol=1e-7)
    np.testing.assert_allclose(made.grasp.rotation.matrix, wanted.grasp.rotation.matrix, atol=1e-7)
    assert made.needle.radius_m == pytest.approx(wanted.needle.radius_m)
    assert as_options(preset.setup, preset.setup) == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--free foo", "center_x_mm"),
        ("--bound circle_radius_mm=25", "NAME=LOW:HIGH"),
        ("--bound circle_radius_mm=-5:20", "circle radius is -5 mm"),
        ("--bound base_tilt_deg=0:nan", "base_tilt_deg is bounded by 0 and nan"),
        ("--bound center_x_mm=-600:0", "-600 mm"),
        ("--arm hand", "raven2-left"),
        ("--out /dev/null/x", "cannot be made"),
        ("--seed -1", "--seed is '-1'"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(trocar, line, words):
    code, out, err = trocar(f"plan setup {line}")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
