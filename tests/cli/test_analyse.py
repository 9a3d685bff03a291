"""``trocar analyse``: recorded joints and trials to velocity, acceleration and jerk."""

import csv
import json

import numpy as np
import pytest

from known_signals import STEP_S, measured, sines
from synthetic import config, synthetic_trial

KNOWN = sines(400)


@pytest.fixture
def table(tmp_path):
    """A CSV of six joints, of which the first is known, and of something else."""
    y = measured(KNOWN, 1e-4)
    path = tmp_path / "joints.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "q1", "q2", "q3", "q4", "q5", "q6", "current"])
        for k, value in enumerate(y):
            writer.writerow([STEP_S * k, value, 0.1, 0.15, 0.0, 0.2, 0.3, k % 5])
    return path


def test_a_csv_of_six_joints_has_a_tip(trocar, table):
    code, out, _ = trocar("analyse", table, "--json")
    summary = json.loads(out)
    assert code == 0
    assert (summary["samples"], summary["arm"]) == (400, "psm-classic")
    assert summary["step_s"] == pytest.approx(STEP_S)
    rms = np.sqrt(np.mean(KNOWN.velocity**2))
    assert summary["joints"]["q1"]["velocity"]["rms"] == pytest.approx(rms, rel=0.02)
    assert summary["joints"]["q4"]["velocity"] == {"rms": 0.0, "max": 0.0}
    assert set(summary["tip"]) == {"x", "y", "z"}
    assert summary["path_m"] > 0


def test_columns_of_ones_own_have_no_tip(trocar, table):
    _, out, _ = trocar("analyse", table, "--columns", "q1,current", "--json")
    summary = json.loads(out)
    assert list(summary["joints"]) == ["q1", "current"]
    assert summary["arm"] is None and "tip" not in summary


def test_files_are_written_and_read_again(trocar, table, tmp_path):
    code, out, _ = trocar("analyse", table, "--out", tmp_path / "motion")
    assert code == 0
    for words in ("400 samples", "tip x", "path of the tip", "motion.csv"):
        assert words in out
    with (tmp_path / "motion" / "motion.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 400
    speed = np.array([float(row["q1_velocity"]) for row in rows])
    assert np.sqrt(np.mean((speed - KNOWN.velocity) ** 2)) < 0.02
    assert (tmp_path / "motion" / "motion.png").stat().st_size > 10_000


def test_a_trial_is_analysed_by_its_own_arm(trocar, tmp_path):
    path = synthetic_trial(config()).save(tmp_path / "trial.npz")
    _, out, _ = trocar("analyse", path, "--json")
    _, other, _ = trocar("analyse", path, "--arm", "psm2", "--json")
    assert json.loads(out)["samples"] == 6001
    assert json.loads(out)["joints"] != json.loads(other)["joints"]
    code, _, err = trocar("analyse", path, "--arm", "psm9")
    assert code == 2 and "choose one of psm1, psm2" in err
