import json

import pytest


@pytest.fixture
def study(trocar):
    return lambda line="": trocar("study", "suture", *line.split())


def test_json_holds_all_rows_beside_the_papers(study):
    code, out, err = study("--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    points, paper = found["table_1"]["points"], found["table_1"]["paper_points"]
    assert paper == {
        "random": {"clockwise": 60.2, "counterclockwise": 42.8, "best": 88.6},
        "optimal": {"clockwise": 65.6, "counterclockwise": 50.6, "best": 100.0},
    }
    for location, row in points.items():
        for allowed, value in row.items():
            assert value == pytest.approx(paper[location][allowed], abs=4)
    assert found["infeasible_positions"] == 0


def test_the_text_says_what_was_fitted_and_identifies_nothing_that_fig_7_agrees_and_draws_every_figure(study, tmp_path):
    code, out, _ = study(f"--out {tmp_path}/study")
    assert code == 0
    text = " ".join(out.split())
    for words in ("65.6", "57.2", "133.6 %", "67, 228", "identifies neither the setup nor the formula", "surrogate"):
        assert words in text
    saved = json.loads((tmp_path / "study" / "summary.json").read_text())
    cells = [f"{value:.4g}" for value in saved["lambda_sweep"]["best_theta_deg"]]
    assert "theta │ " + " │ ".join(cells) in text
    assert "from 28 to 11, at values of lambda that it does not give: reproduced from lambda 0.2 to " in text
    start = saved["best_theta_deg"]
    assert f"at lambda 0.75 the best plan starts at {start:.4g} deg (paper 11 to 28)" in text and 6 <= start <= 33
    assert "fitted: 5 numbers of the setup (base tilt, base spin, grasp behind tip, grasp approach, grasp lean)" in text
    assert saved["fitted"][0] == "base_tilt_deg"
    names = {path.name for path in (tmp_path / "study").iterdir()}
    assert names == {"summary.json", "figures.png", "table_1.png", *(f"figure_{number}.png" for number in range(3, 8))}


def test_demonstrations_give_the_manipulability_of_both_arms(study):
    surrogate, recorded = (json.loads(study(f"--json {option}")[1]) for option in ("", "--demonstrations synthetic"))
    assert "surrogate" in surrogate["manipulability_source"]
    assert "synthetic" in recorded["manipulability_source"]
    assert recorded["lambda_sweep"]["best_theta_deg"] != surrogate["lambda_sweep"]["best_theta_deg"]
    assert recorded["switches_deg"] == surrogate["switches_deg"], "the margin alone decides directions"
