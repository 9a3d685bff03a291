"""``trocar study peg-transfer``, from made-up trials."""

from types import SimpleNamespace

import numpy as np
import pytest

from made_up_study import rows_of, saved
from synthetic import unmarked
from trocar.arms import fk
from trocar.eval.study import Results, read_study, study_of
from trocar.eval.trial import Trial, trial_file
from trocar.report.study import write_study
from trocar.tasks.peg_transfer.report import study
from trocar.tasks.peg_transfer.report.study import HELD, KIND, OPEN, REJECTED, findings
from trocar.tasks.peg_transfer.task import PegTransfer

KEPT = {}
STUDY = ("study", "peg-transfer")


@pytest.fixture(autouse=True)
def _analysed_once(monkeypatch):
    """Analyse each made-up path once in all tests of the study: they are the same few, and each takes a second."""
    analyse = study.analyse_joints

    def analysed(arm, measured, step_s, *rest):
        key = arm.name, measured.tobytes(), step_s, rest
        if key not in KEPT:
            KEPT[key] = analyse(arm, measured, step_s, *rest)
        return KEPT[key]

    monkeypatch.setattr(study, "analyse_joints", analysed)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of two methods in six sessions."""
    return saved(tmp_path_factory.mktemp("study"), sessions=6)


def test_a_row_is_the_trials(made):
    condition = made[1]
    found = rows_of(condition)[2]
    trial = Trial.load(trial_file(condition.folder, 2, 0))
    assert (found.session, found.index, found.attempted, found.succeeded) == (2, 0, 12, 6)
    assert (found.available, found.collisions, found.duration_s) == (12, 4, 60.0)
    assert found.failures == {"DROPPED": 6}
    q = trial.arrays["measured_psm1"][:, :6].astype(float)
    p = fk(trial.scenery.arms["psm1"], q).translation_m
    assert found.path_m == pytest.approx(np.linalg.norm(np.diff(p, axis=0), axis=1).sum(), rel=0.01)
    speed = np.linalg.norm(np.gradient(p, 0.01, axis=0), axis=1)
    assert found.tip["velocity"] == pytest.approx(np.sqrt(np.mean(speed**2)), rel=0.01)


def test_the_summary_counts_sessions(made, tmp_path):
    results, missing = read_study(made, KIND)
    summary, tables, _, files = write_study(tmp_path, "peg-transfer", study_of(PegTransfer), results, missing)
    assert missing == [] and unmarked(tmp_path / "summary.json") == summary
    calibrated, uncalibrated = summary["cells"]
    assert (calibrated["succeeded"], calibrated["attempted"], calibrated["sessions"]) == (72, 72, 6)
    assert (uncalibrated["succeeded"], uncalibrated["failures"]) == (36, {"DROPPED": 36})
    assert calibrated["mean_time_s"]["mean"] == pytest.approx(5.0)
    assert uncalibrated["collisions_per_trial"]["mean"] == 4.0
    assert (summary["study"], summary["model"], summary["transfers"]) == ("peg-transfer", "play", 144)
    assert tables[0].title == "Table II unilateral: 6 trials in 6 sessions each"
    assert all(file.is_file() for file in files)
    page = (tmp_path / "report.html").read_text()
    for words in ("Table II", "paper: surgeon", "as published", "72 of 72", "H3", "performance.png"):
        assert words in page


def test_hypotheses_are_tested_over_sessions(made):
    found = {(one.hypothesis, one.claim.split(":")[0]): one for one in findings(read_study(made, KIND)[0])}
    success = found["H1", "calibrated above uncalibrated"]
    assert (success.difference, success.sessions, success.p) == (0.5, 6, 2**-6)
    assert success.p_adjusted == 2 * 2**-6  # Holm: of two tests
    assert success.verdict == HELD
    assert found["H3", "calibrated below uncalibrated"].difference == -4.0
    assert len(found) == 2  # claims on methods that were not run are left out


def results(method, done, duration_s=60.0, collisions=0, sessions=10):
    """Return results of a method in which so many of twelve transfers succeeded in every trial."""
    rows = [
        SimpleNamespace(
            session=session,
            attempted=12,
            succeeded=done,
            success_rate=done / 12,
            transfer_time_s=(duration_s + session % 3) / 12,
            collisions=collisions,
            path_m=0.1 * duration_s,
        )
        for session in range(sessions)
    ]
    return Results(SimpleNamespace(name="handover", method=method), rows)


def verdicts(*found):
    return {(one.hypothesis, one.claim.split(":")[0]): one.verdict for one in findings(found)}


def test_a_claim_against_which_the_sessions_speak_does_not_hold():
    """The calibrated robot does less, and hits more; the optimised one is slower and goes further."""
    found = verdicts(
        results("uncalibrated", 12, collisions=1), results("calibrated", 6, 60.0, 4), results("optimized", 12, 80.0, 1)
    )
    assert found["H1", "calibrated above uncalibrated"] == REJECTED
    assert found["H1", "optimized above uncalibrated"] == OPEN, "no session differs"
    assert found["H2", "optimized below calibrated"] == REJECTED
    assert found["H3", "calibrated below uncalibrated"] == REJECTED
    assert found["H3", "optimized below uncalibrated"] == OPEN
    assert found["H4", "optimized below calibrated"] == REJECTED
    better = verdicts(results("calibrated", 12, 80.0), results("optimized", 12, 60.0))
    assert better["H2", "optimized below calibrated"] == better["H4", "optimized below calibrated"] == HELD


@pytest.mark.parametrize(
    ("optimized", "calibrated", "sessions", "verdict"),
    [(12, 12, 20, HELD), (12, 9, 20, REJECTED), (9, 12, 20, REJECTED), (12, 12, 1, OPEN), (10, 9, 4, OPEN)],
)
def test_success_is_similar_if_it_surely_differs_by_less_than_five_points(optimized, calibrated, sessions, verdict):
    two = results("optimized", optimized, sessions=sessions), results("calibrated", calibrated, sessions=sessions)
    (similar,) = [one for one in findings(two) if one.claim.endswith("within 5 points")]
    assert similar.verdict == verdict and similar.p is None
    assert similar.difference == pytest.approx((optimized - calibrated) / 12)
    assert similar.claim.startswith("optimized as successful as calibrated")


def test_two_sessions_decide_nothing(tmp_path):
    for one in findings(read_study(saved(tmp_path, sessions=2), KIND)[0]):
        assert one.verdict in (OPEN, REJECTED)


def test_the_report_alone_is_made_from_what_is_there(trocar, tmp_path):
    saved(tmp_path, sessions=2)
    words = ("--variants", "unilateral", "--methods", "calibrated,uncalibrated", "--sessions", 2, "--seed", 2)
    code, out, err = trocar(*STUDY, *words, "--out", tmp_path, "--report-only")
    assert code == 0, err
    for said in ("Table II", "24 of 24", "12 of 24", "paper: surgeon", "H1 to H4", "raw data", "of the cell: recorded"):
        assert said in out
    assert "of available" not in out and "of available" in (tmp_path / "report.html").read_text()
