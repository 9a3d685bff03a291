"""``trocar study demonstrations``: trials of a method in new sessions, and the data set of them."""

import json

import pytest

from trocar.eval.trial import Trial
from trocar.learn.read import read_episode


@pytest.fixture
def command(trocar, tmp_path):
    def run(*words):
        out = tmp_path / "out"
        shared = ("--method", "uncalibrated", "--difficulty", "mild", "--transfers", 1, "--jobs", 1, "--out", out)
        return trocar("study", "demonstrations", "peg-transfer", *shared, *words, "--json"), out

    return run


@pytest.mark.slow
def test_each_episode_is_a_session_of_its_own_and_what_is_there_is_kept(command):
    (code, out, _), folder = command("--episodes", 2, "--command-noise", 1)
    said = json.loads(out)
    assert code == 0 and (said["trials"], said["episodes"]) == (2, 2)
    files = sorted((folder / "trials").glob("session_*/trial_000.npz"))
    first, second = (Trial.load(file) for file in files)
    assert first.about["command_noise"] == 1.0 and first.about["session"] != second.about["session"]
    apart = abs(first.arrays["desired_psm1"] - first.arrays["commanded_psm1"])[:, :3]
    assert apart.max() > 1e-3, "what was asked for has no noise; what was sent has"
    assert read_episode(folder / "data", 1).frames > 30
    written = {file: file.stat().st_mtime_ns for file in files}
    (code, out, _), _ = command("--episodes", 3, "--command-noise", 1)
    assert code == 0 and json.loads(out)["episodes"] == 3
    assert {file: file.stat().st_mtime_ns for file in files} == written
