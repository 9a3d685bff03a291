import json

import pytest

from trocar.tasks.suture.planning.study import PAPER_TABLE_1, Table1


@pytest.fixture
def study(trocar):
    return lambda line="": trocar("study", "suture", *line.split())


def test_json_holds_all_rows_beside_the_papers(study):
    code, out, err = study("--setups 0 --json")
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
    assert "random_setups" not in found


def test_gains_of_the_papers_own_table_are_points_and_ratios(study):
    gains = Table1(PAPER_TABLE_1).gains()
    assert [round(gain["points"], 1) for gain in gains.values()] == [11.4, 34.4, 57.2]
    assert [round(gain["ratio_percent"], 1) for gain in gains.values()] == [12.9, 52.4, 133.6]


def test_the_text_says_that_the_table_identifies_nothing_and_draws_every_figure(study, tmp_path):
    code, out, _ = study(f"--setups 3 --seed 4 --out {tmp_path}/study")
    assert code == 0
    text = " ".join(out.split())
    for words in ("65.6", "57.2", "133.6 %", "67, 228", "identifies neither the setup nor the formula", "surrogate"):
        assert words in text
    names = {path.name for path in (tmp_path / "study").iterdir()}
    assert names == {"summary.json", "figures.png", "table_1.png", *(f"figure_{number}.png" for number in range(3, 8))}
    saved = json.loads((tmp_path / "study" / "summary.json").read_text())
    assert saved["random_setups"]["setups"] == 3


def test_the_text_shows_the_whole_sweep_and_that_fig_7_is_not_reproduced(study):
    sweep = json.loads(study("--setups 0 --json")[1])["lambda_sweep"]
    text = " ".join(study("--setups 0")[1].split())
    cells = [f"{value:.4g}" for value in sweep["best_theta_deg"]]
    assert "theta │ " + " │ ".join(cells) in " ".join(text.split())
    assert "from 28 to 11, at values of lambda that it does not give: not reproduced" in text
    assert "at lambda 0.75 the best plan starts at 5 deg (paper 11 to 28)" in text


def test_the_text_tells_which_formulas_change_the_direction_twice(study):
    line = "--setups 20 --seed 3"
    text = " ".join(study(line)[1].split())
    measures = json.loads(study(f"{line} --json")[1])["random_setups"]["measures"]
    enough, few = text.split("two changes in at least 95 % with ")[1].split("; in less than 95 % with ")
    few = few.split("; with the preset's, ")
    for name, measure in measures.items():
        assert (name in enough.split(", ")) == (measure["two_switches"] >= 0.95)
        assert (name in few[0].split(", ")) == (measure["two_switches"] < 0.95)
    assert few[1].startswith(f"clipped, in {100 * measures['clipped']['two_switches']:.1f} %, ")
    assert "Other seeds draw other setups: the 95 % interval of the default" in few[1]


def test_the_same_seed_gives_the_same_setups(study):
    first, again, other = (json.loads(study(f"--setups 3 --seed {seed} --json")[1]) for seed in (1, 1, 2))
    for found in (first, again, other):
        del found["random_setups"]["compute_s"], found["random_setups"]["seed"]
    assert first == again
    assert first != other


def test_demonstrations_give_the_manipulability_of_both_arms(study):
    surrogate, recorded = (
        json.loads(study(f"--setups 0 --json {option}")[1]) for option in ("", "--demonstrations synthetic")
    )
    assert "surrogate" in surrogate["manipulability_source"]
    assert "synthetic" in recorded["manipulability_source"]
    assert recorded["assistant_source"] == recorded["manipulability_source"]
    assert recorded["lambda_sweep"]["best_theta_deg"] != surrogate["lambda_sweep"]["best_theta_deg"]
    assert recorded["switches_deg"] == surrogate["switches_deg"], "the margin alone decides directions"


@pytest.mark.parametrize(
    "line, words",
    [
        ("--preset magic", "paper-demo"),
        ("--setups -1", "number of setups is -1"),
        ("--seed -1", "seed is -1"),
        ("--positions 90", "multiple of 4"),
        ("--setups 0 --out {file}", "is a file"),
        ("--setups 0 --out {file}/x", "cannot be made"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(study, tmp_path, line, words):
    (tmp_path / "file").write_text("")
    code, out, err = study(line.format(file=tmp_path / "file"))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
