"""Fixtures for tests of commands. Fixtures import heavy modules themselves: every process of pytest loads this file."""

import gc
import sys
import weakref

import pytest

from trocar.cli import main


@pytest.fixture
def trocar(monkeypatch, capsys):
    """Run a command in this process; return exit code, stdout and stderr."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["trocar", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        out = capsys.readouterr()
        return stop.value.code or 0, out.out, out.err

    return command


@pytest.fixture
def unpictured(monkeypatch):
    """Draw no pictures of runs, and make no replay."""
    monkeypatch.setattr("trocar.report.files._pictures", lambda *rest: [])
    monkeypatch.setattr("trocar.report.files._chart", lambda *rest: None)
    monkeypatch.setattr("trocar.report.files.can_photograph", lambda: False)
    monkeypatch.setattr("trocar.report.files.find_spec", lambda module: None)


@pytest.fixture
def played(monkeypatch, unpictured):
    """Replace trials by synthetic ones without pictures; return the list of (session, trial) that were played."""
    from synthetic import prepared, synthetic_trial

    done = []

    def run_trial(config, session, index, listener=None, *, raise_errors=False, attendant=None):
        done.append((session.number, index))
        trial = synthetic_trial(config, index, session=session.number)
        for event in trial.events:
            listener(event)
        return trial

    monkeypatch.setattr("trocar.eval.jobs.prepare", prepared)
    monkeypatch.setattr("trocar.eval.jobs.run_trial", run_trial)
    return done


@pytest.fixture
def alive(monkeypatch):
    """Return a list that receives, at each load of a trial, how many loaded before it are still in memory."""
    from trocar.eval.trial import Trial

    read, counts, load = [], [], Trial.load

    def watched(path):
        gc.collect()
        counts.append(sum(one() is not None for one in read))
        trial = load(path)
        read.append(weakref.ref(trial))
        return trial

    monkeypatch.setattr(Trial, "load", watched)
    return counts
