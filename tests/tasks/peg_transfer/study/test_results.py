"""A study agrees with its trials, and reads them one after the other."""

import gc
import json
import weakref

import numpy as np
import pytest

from made_up_study import rows_of, saved
from synthetic import unmarked
from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.eval.rows import row_file
from trocar.eval.trial import Trial, trial_file
from trocar.tasks.peg_transfer.study import figures, row
from trocar.tasks.peg_transfer.study.hypotheses import HELD, OPEN, REJECTED, findings
from trocar.tasks.peg_transfer.study.report import write_study
from trocar.tasks.peg_transfer.study.results import results_of
from trocar.tasks.peg_transfer.study.row import read_row


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study of two methods in six sessions."""
    return saved(tmp_path_factory.mktemp("study"), sessions=6)


def test_a_row_is_the_trials(made):
    cell = made[1]
    found = rows_of(cell)[2]
    trial = Trial.load(trial_file(cell.folder, 2, 0))
    assert (found.session, found.index, found.attempted, found.succeeded) == (2, 0, 12, 6)
    assert (found.available, found.collisions, found.duration_s) == (12, 4, 60.0)
    assert found.failures == {"DROPPED": 6}
    q = trial.arrays["measured_psm1"][:, :6].astype(float)
    p = fk(trial.scenery.arms["psm1"], q).translation_m
    assert found.path_m == pytest.approx(np.linalg.norm(np.diff(p, axis=0), axis=1).sum(), rel=0.01)
    speed = np.linalg.norm(np.gradient(p, 0.01, axis=0), axis=1)
    assert found.tip["velocity"] == pytest.approx(np.sqrt(np.mean(speed**2)), rel=0.01)


def test_a_row_is_kept_and_made_again_where_it_does_not_fit(made, monkeypatch):
    cell = made[0]
    path = trial_file(cell.folder, 0, 0)
    first = read_row(path, cell.config.fingerprint)
    with monkeypatch.context() as patch:
        patch.setattr(row, "row_of", lambda trial: pytest.fail("it was made again"))
        assert read_row(path, cell.config.fingerprint) == first
    for text in ("", "[]", json.dumps({"version": 0}), row_file(path).read_text().replace('"attempted"', '"other"')):
        row_file(path).write_text(text)
        assert read_row(path, cell.config.fingerprint) == first


@pytest.mark.slow
def test_no_more_than_one_trial_is_alive_at_a_time(made, tmp_path, monkeypatch):
    cells = saved(tmp_path, sessions=1, trials=3)
    alive: list[weakref.ref] = []
    most = []
    load = Trial.load

    def watched(path):
        gc.collect()
        most.append(sum(one() is not None for one in alive))
        trial = load(path)
        alive.append(weakref.ref(trial))
        return trial

    for module in (row.Trial, figures.Trial):
        monkeypatch.setattr(module, "load", watched)
    results, _ = results_of(cells)
    write_study(tmp_path, results, [])
    assert len(alive) == 6 + 2  # each trial once for its row, one of each cell for its picture
    assert max(most) <= 1  # that of the picture before, at most


def test_the_summary_counts_sessions(made, tmp_path):
    results, missing = results_of(made)
    summary, _, files = write_study(tmp_path, results, missing)
    assert missing == []
    assert unmarked(tmp_path / "summary.json") == summary
    calibrated, uncalibrated = summary["cells"]
    assert (calibrated["succeeded"], calibrated["attempted"], calibrated["sessions"]) == (72, 72, 6)
    assert (uncalibrated["succeeded"], uncalibrated["failures"]) == (36, {"DROPPED": 36})
    assert calibrated["mean_time_s"]["mean"] == pytest.approx(5.0)
    assert uncalibrated["collisions_per_trial"]["mean"] == 4.0
    assert all(file.is_file() for file in files)
    page = (tmp_path / "report.html").read_text()
    for words in ("Table II", "paper: surgeon", "as published", "72 of 72", "H3", "performance.png"):
        assert words in page


def test_what_is_missing_is_said(made, tmp_path):
    cells = saved(tmp_path, sessions=2)
    trial_file(cells[0].folder, 1, 0).unlink()
    row_file(trial_file(cells[0].folder, 1, 0)).unlink(missing_ok=True)
    results, missing = results_of(cells)
    assert [len(result.rows) for result in results] == [1, 2]
    assert len(missing) == 1 and "session_01" in missing[0]
    for cell in cells:
        for path in cell.folder.glob("session_*/*"):
            path.unlink()
    with pytest.raises(TrocarError, match="no trial that can be read"):
        results_of(cells)


def test_hypotheses_are_tested_over_sessions(made):
    found = {(one.hypothesis, one.claim.split(":")[0]): one for one in findings(results_of(made)[0])}
    success = found["H1", "calibrated above uncalibrated"]
    assert (success.difference, success.sessions, success.p) == (0.5, 6, 2**-6)
    assert success.p_adjusted == 2 * 2**-6  # Holm: of two tests
    assert success.verdict == HELD
    assert found["H3", "calibrated below uncalibrated"].difference == -4.0
    assert len(found) == 2  # claims on methods that were not run are left out


def test_two_sessions_decide_nothing(tmp_path):
    for one in findings(results_of(saved(tmp_path, sessions=2))[0]):
        assert one.verdict in (OPEN, REJECTED)
        assert one.verdict != HELD
