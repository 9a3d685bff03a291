"""The study of debridement, from hand-made trials in the folders of its conditions."""

import json

import pytest

from made_up_debridement import saved
from synthetic import unmarked
from trocar.eval.study import conditions_of, read_study, study_of
from trocar.report.study import write_study
from trocar.tasks.debridement.report.study import DebridementStudy, left_behind, speedups
from trocar.tasks.debridement.task import Debridement

KIND = DebridementStudy.kind
STUDY = ("study", "debridement")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of the paper's method in four sessions, with one arm and with two."""
    folder = tmp_path_factory.mktemp("study")
    return folder, saved(folder, sessions=4)


def test_a_study_is_done_in_a_cell_of_one_difficulty_and_says_which(trocar, tmp_path):
    harder = {"difficulty": "recorded", "flaws": ("kinematics=1.5",)}
    one, other = (
        conditions_of(Debridement, tmp_path, values="2", methods="paper", **more)[0].config for more in (harder, {})
    )
    assert one.fingerprint != other.fingerprint
    saved(tmp_path, sessions=1, **harder)
    words = (*STUDY, "--methods", "paper", "--sessions", 1, "--seed", 2, "--out", tmp_path, "--report-only")
    code, out, err = trocar(*words, "--difficulty", "recorded", "--flaw", "kinematics=1.5")
    assert code == 0, err
    assert "difficulty of the cell: recorded, kinematics=1.5" in out
    assert json.loads((tmp_path / "summary.json").read_text())["difficulty"] == ["recorded", "kinematics=1.5"]
    assert trocar(*words, "--difficulty", "easy")[0] == 2


def test_the_summary_counts_sessions(made):
    folder, conditions = made
    results, missing = read_study(conditions, KIND)
    summary, _, _, files = write_study(folder, "debridement", study_of(Debridement), results, missing)
    assert missing == [] and unmarked(folder / "summary.json") == summary
    one, two = summary["cells"]
    assert (one["s_per_fragment"]["mean"], two["s_per_fragment"]["mean"]) == (10.0, 5.0)
    assert (two["sessions"], two["cleared"], two["fragments"]) == (4, 24, 24)
    multiple = two["failure_modes"]["multiple_grasps"]
    assert (multiple["count"], multiple["of"]) == (4, 28)
    assert two["within_paper"]["multiple_grasps"] == "yes" and one["within_paper"]["multiple_grasps"] == "below"
    assert {file.name for file in files} == {"summary.json", "times.png", "failures.png", "report.html"}
    page = (folder / "report.html").read_text()
    for words in ("Table I, two arms", "91.8", "5.0 [5.0, 5.0]", "4/28", "times.png", "one-arm-paper", "Clopper"):
        assert words in page


def test_what_was_left_behind_is_said():
    cell = {"variant": "two-arms", "method": "paper", "fragments": 12, "cleared": 11, "trials": 2}
    (said,) = left_behind([cell | {"unfinished_trials": 1, "left_behind": {"NOT_CLEARED": 1}}])
    assert said.startswith("two arms, paper: 1 of 12 fragments left behind (not cleared 1); 1 of 2 trials stopped")
    assert left_behind([cell | {"cleared": 12, "unfinished_trials": 0, "left_behind": {}}]) == []


def test_one_arm_is_compared_with_two_in_the_same_sessions(made):
    (found,) = speedups(read_study(made[1], KIND)[0])
    assert (found["method"], found["sessions"], found["paper"]) == ("paper", 4, 1.5)
    assert found["one_over_two"] == {"mean": 2.0, "low": 2.0, "high": 2.0}
    assert speedups(read_study(made[1][:1], KIND)[0]) == [], "without a counterpart nothing is compared"


def test_the_report_alone_is_made_from_what_is_there(trocar, made):
    words = (*STUDY, "--methods", "paper", "--sessions", 4, "--seed", 2, "--out", made[0], "--report-only")
    code, out, err = trocar(*words)
    assert code == 0, err
    for said in ("Table I, one arm, paper: 4 trials in 4 sessions", "24 of 24", "One arm against two", "2.00 [2.00"):
        assert said in out
    assert json.loads(trocar(*words, "--json")[1])["study"] == "debridement"
