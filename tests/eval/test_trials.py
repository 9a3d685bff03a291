"""Trials from Python: one call, rows, comparisons."""

import pytest

import trocar
from synthetic import config, synthetic_trial
from trocar.errors import UnknownName
from trocar.eval import jobs
from trocar.eval.prepare import Prepared
from trocar.eval.trial import trial_file
from trocar.eval.trials import Trials


def saved(folder, run, failed=0, sessions=4):
    """Return trials of so many sessions, of each so many transfers have failed."""
    paths = [trial_file(folder, session, 0) for session in range(sessions)]
    for session, path in enumerate(paths):
        path.parent.mkdir(parents=True)
        synthetic_trial(run, 0, dict.fromkeys(range(failed), "DROPPED"), session).save(path)
    return Trials(paths)


def test_trials_say_in_a_line_what_came_of_them(tmp_path):
    trials = saved(tmp_path, config(), failed=3)
    assert repr(trials) == "<4 trials of peg-transfer unilateral calibrated in 4 sessions: 36 of 48 transfers>"
    assert repr(trials[:1]) == "<1 trial of peg-transfer unilateral calibrated in 1 session: 9 of 12 transfers>"
    assert repr(trials[:0]) == "<no trials>"


def test_one_call_runs_what_is_missing_and_returns_all(tmp_path, monkeypatch):
    done = []

    def run_trial(run, prepared, index, *_, **__):
        done.append((prepared.number, index, run.settings, run.task.transfers, run.how_difficult))
        return synthetic_trial(run, index, session=prepared.number)

    def prepare(run, number, folder, **_):
        (folder / f"session_{number:02d}").mkdir(exist_ok=True)
        return Prepared(number, None, {})

    monkeypatch.setattr(jobs, "run_trial", run_trial)
    monkeypatch.setattr(jobs, "prepare", prepare)
    monkeypatch.chdir(tmp_path)
    given = {"method": "uncalibrated", "sessions": 2, "seed": 1, "difficulty": "mild", "settings": {"settle_s": 0.2}}
    first = trocar.run("peg-transfer", **given)
    assert done == [(session, 0, ("settle_s=0.2",), 12, ["mild"]) for session in (0, 1)]
    assert first[0].about["method"] == "uncalibrated" and len(trocar.run("peg-transfer", **given)) == 2
    assert len(done) == 2, "the trials that are there are not run again"
    trocar.run("peg-transfer", **given, transfers=3)
    assert done[2][3] == 3 and len(list((tmp_path / "out").iterdir())) == 2
    with pytest.raises(UnknownName, match="option 'metod' is unknown; did you mean 'method'"):
        trocar.run("peg-transfer", metod="best")
