"""The study of debridement, from hand-made trials in the folders of its cells."""

import json

import pytest
from typer.testing import CliRunner

from made_up_debridement import saved
from synthetic import unmarked
from trocar.errors import TrocarError
from trocar.eval.trial import trial_file
from trocar.tasks.debridement.study import results as study_results
from trocar.tasks.debridement.study.cells import cells_of
from trocar.tasks.debridement.study.command import app
from trocar.tasks.debridement.study.report import left_behind, write_study
from trocar.tasks.debridement.study.results import read_row, results_of, speedups


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of the paper's method in four sessions, with one arm and with two."""
    folder = tmp_path_factory.mktemp("study")
    return folder, saved(folder, sessions=4)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_conditions_are_arms_times_methods(tmp_path):
    cells = cells_of(tmp_path, sessions=2, trials=3)
    assert [cell.folder.name for cell in cells] == [
        f"{arms}-{method}" for arms in ("one-arm", "two-arms") for method in ("best", "best-1cm", "paper")
    ]
    assert all(len(cell.places) == 6 for cell in cells)
    assert len({cell.config.fingerprint for cell in cells}) == 6


def test_a_study_is_done_in_a_cell_of_one_difficulty_and_says_which(tmp_path):
    harder = {"difficulty": "recorded", "flaws": ("kinematics=1.5",)}
    cells = cells_of(tmp_path / "harder", "2", "paper", sessions=1, **harder)
    assert cells[0].config.fingerprint != cells_of(tmp_path, "2", "paper", sessions=1)[0].config.fingerprint
    saved(tmp_path, sessions=1, **harder)
    told = ("--methods", "paper", "--sessions", 1, "--seed", 2, "--out", tmp_path, "--report-only")
    result = run(*told, "--difficulty", "recorded", "--flaw", "kinematics=1.5")
    assert result.exit_code == 0, result.output
    assert "difficulty of the cell: recorded, kinematics=1.5" in result.output
    assert json.loads((tmp_path / "summary.json").read_text())["difficulty"] == ["recorded", "kinematics=1.5"]
    assert isinstance(run(*told, "--difficulty", "easy").exception, TrocarError)


def test_the_summary_counts_sessions(made):
    folder, cells = made
    results, missing = results_of(cells)
    summary, files = write_study(folder, results, missing)
    assert missing == [] and unmarked(folder / "summary.json") == summary
    one, two = summary["cells"]
    assert (one["s_per_fragment"]["mean"], two["s_per_fragment"]["mean"]) == (10.0, 5.0)
    assert (two["sessions"], two["cleared"], two["fragments"]) == (4, 24, 24)
    multiple = two["failure_modes"]["multiple_grasps"]
    assert (multiple["count"], multiple["of"]) == (4, 28)
    assert two["within_paper"]["multiple_grasps"] == "yes" and one["within_paper"]["multiple_grasps"] == "below"
    assert {file.name for file in files} == {"summary.json", "times.png", "failures.png", "report.html"}
    page = (folder / "report.html").read_text()
    for words in ("Table I, paper", "91.8", "5.0 [5.0, 5.0]", "4/28", "times.png", "one-arm-paper", "Clopper-Pearson"):
        assert words in page


def test_what_was_left_behind_is_said():
    cell = {"variant": "two-arms", "method": "paper", "fragments": 12, "cleared": 11, "trials": 2}
    (said,) = left_behind([cell | {"unfinished_trials": 1, "left_behind": {"NOT_CLEARED": 1}}])
    assert said.startswith("two arms, paper: 1 of 12 fragments left behind (not cleared 1); 1 of 2 trials stopped")
    assert left_behind([cell | {"cleared": 12, "unfinished_trials": 0, "left_behind": {}}]) == []


def test_one_arm_is_compared_with_two_in_the_same_sessions(made):
    (found,) = speedups(results_of(made[1])[0])
    assert (found["method"], found["sessions"], found["paper"]) == ("paper", 4, 1.5)
    assert found["one_over_two"] == {"mean": 2.0, "low": 2.0, "high": 2.0}


def test_without_a_counterpart_nothing_is_compared(made):
    results, _ = results_of(made[1][:1])
    assert speedups(results) == []


def test_a_row_is_kept_beside_its_trial(made, monkeypatch):
    cell = made[1][0]
    path = trial_file(cell.folder, 0, 0)
    first = read_row(path, cell.config.fingerprint)
    monkeypatch.setattr(study_results, "row_of", lambda trial: pytest.fail("it was made again"))
    assert read_row(path, cell.config.fingerprint) == first


def test_the_report_alone_is_made_from_what_is_there(made):
    result = run("--methods", "paper", "--sessions", 4, "--seed", 2, "--out", made[0], "--report-only")
    assert result.exit_code == 0, result.output
    title = "Table I, one arm, paper: 4 trials in 4 sessions"
    for words in (title, "24 of 24", "One arm against two", "2.00 [2.00, 2.00]"):
        assert words in result.output
    as_json = run("--methods", "paper", "--sessions", 4, "--seed", 2, "--out", made[0], "--report-only", "--json")
    assert json.loads(as_json.output)["study"] == "debridement"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--arms", "3"), "choose from 1, 2"),
        (("--methods", "magic"), "choose from best"),
        (("--fragments", "0"), "give 1 to 12"),
        (("--jobs", "0"), "--jobs is 0"),
        (("--report-only",), "does not exist; give that of a study with --out"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, words, said):
    result = run(*words, "--out", tmp_path / "study")
    assert isinstance(result.exception, TrocarError) and said in str(result.exception)
