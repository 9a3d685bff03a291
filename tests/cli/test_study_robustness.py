"""``trocar study robustness``: a small one from end to end."""

import json

import pytest


@pytest.mark.slow
def test_a_small_study_goes_on_where_it_stopped(trocar, tmp_path):
    line = ("study", "robustness", "peg-transfer", "--transfers", 1, "--methods", "uncalibrated", "--flaws", "offsets")
    line = (*line, "--scales", "0", "--sessions", 1, "--jobs", 1, "--seed", 2, "--out", tmp_path / "study")
    code, out, error = trocar(*line, "--json")
    assert code == 0, error
    summary = json.loads(out)
    (row,) = summary["conditions"]
    assert (row["flaw"], row["size"], row["unit"], row["goals"]) == ("offsets", 0.0, "deg", 1)
    trial = tmp_path / "study" / row["folder"] / "session_00" / "trial_000.npz"
    written = trial.stat().st_mtime_ns
    code, out, _ = trocar(*line)
    assert code == 0 and trial.stat().st_mtime_ns == written, "nothing is run again"
    assert "offsets" in out and (tmp_path / "study" / "robustness.png").stat().st_size > 5000


def test_what_cannot_be_varied_is_said_before_anything_is_run(trocar, tmp_path):
    code, _, error = trocar("study", "robustness", "suture", "--flaws", "kinematics", "--out", tmp_path / "no")
    assert code == 2 and "--flaws names 'kinematics'" in error and not (tmp_path / "no").exists()
