"""The summary of a run says what its trials say."""

import json

import pytest

from synthetic import PARTS_S, TRANSFER_S, synthetic_trial
from trocar.errors import TrocarError
from trocar.report import load_trials, summarise, wilson_interval, write_report
from trocar.report.tables import parts_table, run_table
from trocar.trials import Plan, trial_file

PLAN = Plan(seed=3, trials=2)
KEYS = {
    *("task", "variant", "method", "seed", "trials", "attempted", "succeeded", "success_rate", "success_ci95"),
    *("mean_time_s", "parts_s", "collisions_per_trial", "failures", "compute_ms", "missed_budgets"),
    *("realtime_factor", "versions"),
}
"""What DESIGN.md promises scripts."""


@pytest.fixture
def trials():
    return [
        synthetic_trial(PLAN, 0, {2: "DROPPED", 5: "NOT_PLACED", 7: "NO_BLOCK"}),
        synthetic_trial(PLAN, 1, {1: "DROPPED"}),
    ]


def test_every_promised_key_is_there_and_is_json(trials):
    summary = summarise(trials)
    assert set(summary) >= KEYS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert (summary["task"], summary["variant"], summary["method"], summary["seed"]) == (
        "peg-transfer",
        "unilateral",
        "calibrated",
        3,
    )


def test_transfers_are_counted_as_attempted(trials):
    summary = summarise(trials)
    assert summary["trials"] == 2
    assert summary["attempted"] == 23
    assert summary["succeeded"] == 20
    assert summary["success_rate"] == pytest.approx(20 / 23)
    assert summary["success_ci95"] == pytest.approx(wilson_interval(20, 23))
    assert summary["failures"] == {"DROPPED": 2, "NOT_PLACED": 1}
    assert summary["collisions_per_trial"] == 1.5
    assert summary["complete_trials"] == 0


def test_parts_add_up_to_the_mean_time():
    summary = summarise([synthetic_trial(PLAN, 0), synthetic_trial(PLAN, 1)])
    assert summary["mean_time_s"] == pytest.approx(TRANSFER_S)
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    for name, seconds in PARTS_S.items():
        assert summary["parts_s"][name] == pytest.approx(seconds)
    assert summary["parts_s"]["other"] == pytest.approx(TRANSFER_S - sum(PARTS_S.values()))
    assert summary["complete_trials"] == 2


def test_compute_is_real_time_and_budgets_are_counted(trials):
    summary = summarise(trials)
    assert summary["compute_ms"] == {
        "perception": {"p50": pytest.approx(30.0), "p95": pytest.approx(30.0)},
        "planning": {"p50": pytest.approx(200.0), "p95": pytest.approx(200.0)},
    }
    assert summary["missed_budgets"] == pytest.approx(0.5)
    assert summary["realtime_factor"] == pytest.approx(12 * TRANSFER_S / 10.0)


def test_no_success_and_no_attempt_are_values_of_json():
    nothing = summarise([synthetic_trial(PLAN, 0, dict.fromkeys(range(12), "NO_BLOCK"))])
    assert nothing["attempted"] == 0
    assert nothing["success_rate"] is None and nothing["mean_time_s"] is None
    json.dumps(nothing, allow_nan=False)
    assert run_table(nothing) is not None and parts_table(nothing) is not None
    failed = summarise([synthetic_trial(PLAN, 0, dict.fromkeys(range(12), "DROPPED"))])
    assert failed["success_rate"] == 0.0
    assert failed["success_ci95"][0] == 0.0 < failed["success_ci95"][1] < 0.3


def test_uncalibrated_runs_name_no_model():
    assert summarise([synthetic_trial(Plan(method="uncalibrated"))])["model"] is None


def test_no_trials_are_said_so(tmp_path):
    with pytest.raises(TrocarError, match="no finished trials"):
        summarise([])
    with pytest.raises(TrocarError, match=r"holds no trial_\*\.npz"):
        load_trials(tmp_path)
    with pytest.raises(TrocarError, match="does not exist"):
        load_trials(tmp_path / "nowhere")


def test_a_report_writes_what_it_names_and_the_same_again(trials, tmp_path):
    for index, trial in enumerate(trials):
        trial.save(trial_file(tmp_path, index))
    summary, files = write_report(tmp_path, load_trials(tmp_path))
    first = (tmp_path / "summary.json").read_bytes()
    assert json.loads(first) == summary
    assert all(file.stat().st_size > 0 for file in files)
    assert {"summary.json", "paths.png", "timechart.png", "report.html"} <= {file.name for file in files}
    write_report(tmp_path, load_trials(tmp_path))
    assert (tmp_path / "summary.json").read_bytes() == first
    page = (tmp_path / "report.html").read_text()
    assert "paths.png" in page and "20" in page
