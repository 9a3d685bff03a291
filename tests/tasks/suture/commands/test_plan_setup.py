import json

import numpy as np
import pytest


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
    code, out, _ = trocar("plan setup --arm raven2-left --free port --free grasp --evaluations 1500 --json")
    found = json.loads(out)
    assert (code, found["start_feasible"], found["feasible"], found["crossing_deg"]) == (0, False, True, [])
    code, out, _ = trocar(found["command"].removeprefix("trocar ") + " --json")
    again = json.loads(out)
    assert (code, again["arm"], again["feasible"]) == (0, "raven2-left", True)


def test_the_printed_command_keeps_the_gaps_that_were_asked_for(trocar):
    line = "plan setup --free center_x_mm --evaluations 96 --gap 80:100 --json"
    found = json.loads(trocar(line)[1])
    assert "--gap 80:100" in found["command"]
    assert np.diff(found["positions_deg"]).min() >= 80 and np.diff(found["positions_deg"]).max() <= 100


def test_the_printed_command_plans_in_the_setup_that_was_found(trocar, tmp_path):
    _, out, _ = trocar(f"plan setup --free circle --free grasp --evaluations 100 --seed 5 --out {tmp_path}/new --json")
    found = json.loads(out)
    assert (tmp_path / "new" / "plan.png").stat().st_size > 10_000
    assert found["command"] == f"trocar plan suture --preset {tmp_path}/new/setup.toml --count 4"
    code, again, _ = trocar(found["command"].removeprefix("trocar ") + " --json")
    assert code == 0, "feasible there too; the reward is scaled anew, so the plan may be another"
    again = json.loads(again)
    assert again["jaws_can_hold_needle"] is True and again["crossing_deg"] == []
    circle = {number["name"]: number["to"] for number in found["free"]}
    assert 1e3 * again["setup"]["circle"]["radius_m"] == pytest.approx(circle["circle_radius_mm"], abs=1e-6)
    _, out, _ = trocar("plan setup --free circle --free grasp --evaluations 100 --seed 5 --json")
    words = json.loads(out)["command"]
    assert f"--set circle_radius_mm={circle['circle_radius_mm']:.9g}" in words
    in_words = json.loads(trocar(words.removeprefix("trocar ") + " --json")[1])
    assert in_words["positions_deg"] == again["positions_deg"] and in_words["rewards"] == again["rewards"]


def test_where_nothing_better_is_found_the_printed_command_plans_in_the_preset(trocar, tmp_path):
    line = "plan setup --free grasp_lean_deg --bound grasp_lean_deg=85:86 --evaluations 96 --count 3 --json"
    command = json.loads(trocar(f"{line} --out {tmp_path}/new")[1])["command"]
    assert command == f"trocar plan suture --preset {tmp_path}/new/setup.toml --count 3"
    assert json.loads(trocar(line)[1])["command"] == "trocar plan suture --preset default --count 3"


def test_what_crosses_in_the_tissue_is_not_recommended(trocar):
    code, out, _ = trocar("plan setup --free port --evaluations 100 --count 12 --json")
    found = json.loads(out)
    assert (code, found["sound"], found["command"]) == (1, False, None) and found["crossing_deg"]
    text = " ".join(trocar("plan setup --free port --evaluations 100 --count 12")[1].split())
    assert "no plan was found that can be recommended: sutures cross" in text and "to plan there" not in text


def test_any_number_of_sutures_is_searched_for(trocar):
    found = json.loads(trocar("plan setup --free center_x_mm --evaluations 96 --count 7 --json")[1])
    assert np.diff(found["positions_deg"]) == pytest.approx([360 / 7] * 6)


def test_settings_are_kept_while_others_are_searched(trocar):
    line = "plan setup --free center_x_mm --evaluations 96 --set base_up_mm=110 --json"
    found = json.loads(trocar(line)[1])
    assert "--set base_up_mm=110" in found["command"]
