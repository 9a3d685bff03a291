"""``trocar view`` serves the trial that was asked for, opens a browser unless told not to, and speaks on stderr."""

import urllib.request

import pytest

from synthetic import config, keep, synthetic_trial
from trocar.eval.trial import Trial, trial_file

pytest.importorskip("viser")
from trocar.cli import report as cli
from trocar.view.trial_view import TrialView

TITLE = "peg-transfer unilateral calibrated"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run with three trials of two sessions."""
    folder = tmp_path_factory.mktemp("run")
    for session, index in ((0, 0), (0, 3), (1, 2)):
        keep(synthetic_trial(config(), index, session=session), folder)
    return folder


@pytest.fixture
def served(monkeypatch):
    """What a run of the command opens and serves; it ends where it would wait."""
    seen = {"opened": [], "pages": []}

    def wait(shown):
        with urllib.request.urlopen(f"http://127.0.0.1:{shown.port}") as answer:
            seen["pages"].append((shown.port, answer.read(15)))
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.webbrowser, "open", seen["opened"].append)
    monkeypatch.setattr(TrialView, "play", wait)
    return seen


@pytest.fixture
def loaded(monkeypatch):
    """The files that the command loads."""
    files, load = [], Trial.load
    monkeypatch.setattr("trocar.eval.trial.Trial.load", staticmethod(lambda file: files.append(file) or load(file)))
    return files


def test_a_trial_is_served_and_a_browser_opened_until_ctrl_c(trocar, run, served, loaded):
    code, out, err = trocar("view", run, "--session", "1", "--trial", "2", "--port", "0")
    assert (code, out) == (0, "")
    ((port, page),) = served["pages"]
    assert page == b"<!doctype html>"
    assert loaded == [trial_file(run, 1, 2)]
    assert served["opened"] == [f"http://127.0.0.1:{port}"]
    assert err == f"{TITLE}: http://127.0.0.1:{port} in a browser; Ctrl-C ends\n"
    with pytest.raises(OSError):
        urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=2)


def test_no_browser_is_opened_if_not_wanted(trocar, run, served, loaded):
    assert trocar("view", run, "--port", "0", "--no-open")[0] == 0
    assert loaded == [trial_file(run, 0, 0)]
    assert served["opened"] == []
