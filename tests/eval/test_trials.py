"""Trials from Python: one call, rows, comparisons."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

import trocar
from synthetic import config, keep, prepared, synthetic_trial
from trocar.errors import InvalidInput, UnknownName
from trocar.eval import jobs
from trocar.eval.trials import Trials


def saved(folder, run, failed=0, sessions=4):
    """Return trials of so many sessions, of each so many transfers have failed."""
    trials = (synthetic_trial(run, 0, dict.fromkeys(range(failed), "DROPPED"), session) for session in range(sessions))
    changed = (replace(one, duration_s=60.0 + 12.0 * failed, collisions=one.collisions * failed) for one in trials)
    return Trials([keep(trial, folder) for trial in changed])


def test_trials_say_in_a_line_what_came_of_them(tmp_path):
    trials = saved(tmp_path, config(), failed=3)
    assert repr(trials) == "<4 trials of peg-transfer unilateral calibrated in 4 sessions: 36 of 48 transfers>"
    assert repr(trials[:1]) == "<1 trial of peg-transfer unilateral calibrated in 1 session: 9 of 12 transfers>"
    assert repr(trials[:0]) == "<no trials>"


def test_there_is_a_row_for_each_goal(tmp_path, monkeypatch):
    trials = saved(tmp_path, config(), failed=1, sessions=2)
    rows = trials.rows()
    assert [(row["session"], row["goal"]) for row in rows] == [(s, k) for s in (0, 1) for k in range(12)]
    assert [row["failure"] for row in rows if not row["succeeded"]] == ["DROPPED"] * 2
    assert {(row["task"], row["method"], row["seed"]) for row in rows} == {("peg-transfer", "calibrated", 0)}
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda given: ("frame", given)))
    assert trials.to_frame() == ("frame", rows)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InvalidInput, match="needs pandas, which is not installed"):
        trials.to_frame()


def test_two_runs_are_compared_session_by_session(tmp_path):
    good = saved(tmp_path / "good", config())
    bad = saved(tmp_path / "bad", config(method="uncalibrated"), failed=6)
    found = good.compare(bad)
    assert (found.success_rate.mean, found.time_s.mean) == (0.5, -6.0)
    assert found.collisions.mean < 0
    assert {one.p for one in (found.success_rate, found.time_s, found.collisions)} == {2**-4}
    assert {one.p for one in (bad.compare(good).success_rate, bad.compare(good).time_s)} == {1.0}
    assert repr(found).startswith("<Comparison over 4 sessions: success_rate +0.5, time_s -6, collisions -")
    with pytest.raises(InvalidInput, match="did not meet the same sessions"):
        good.compare(saved(tmp_path / "other", config(seed=9)))


def test_one_call_runs_what_is_missing_and_returns_all(tmp_path, monkeypatch):
    done = []

    def run_trial(run, session, index, *_, **__):
        done.append((session.number, index, run.settings, run.task.transfers, run.how_difficult))
        return synthetic_trial(run, index, session=session.number)

    monkeypatch.setattr(jobs, "run_trial", run_trial)
    monkeypatch.setattr(jobs, "prepare", prepared)
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
