"""Whole trials of sutures: what compensation brings, and what the seed decides."""

import json

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.report import summarise
from trocar.report.driven import joint_errors
from trocar.trials import Plan, prepare, run_trial, trial_file


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """One suture by each method in the same cell."""
    found = {}
    for method in ("uncalibrated", "calibrated"):
        plan = Plan("suture", method=method, seed=3, sutures=1)
        found[method] = plan, *prepare(plan, tmp_path_factory.mktemp(method))
    return {method: (run_trial(*prepared, 0), prepared) for method, prepared in found.items()}


def test_compensated_cables_drive_the_suture_and_believed_encoders_do_not(trials):
    calibrated, uncalibrated = (summarise([trials[m][0]]) for m in ("calibrated", "uncalibrated"))
    assert (calibrated["succeeded"], calibrated["attempted"]) == (1, 1)
    assert (uncalibrated["succeeded"], uncalibrated["attempted"]) == (0, 1)
    for joint in ("roll", "wrist_pitch", "wrist_yaw"):
        assert calibrated["joint_error_deg"][joint]["rms"] < 0.2 * uncalibrated["joint_error_deg"][joint]["rms"]
        assert calibrated["joint_error_deg"][joint]["rms"] < 1.5
    assert calibrated["tip_error_mm"]["max"] < 1.5 < uncalibrated["tip_error_mm"]["max"]


def test_outer_joints_have_no_cables_in_the_way(trials):
    for trial, _ in trials.values():
        assert np.degrees(np.abs(joint_errors(trial)[:, :2])).max() < 0.5


def test_the_same_seed_writes_the_same_bytes(trials, tmp_path):
    trial, prepared = trials["calibrated"]
    for name, again in (("first", trial), ("second", run_trial(*prepared, 0))):
        (tmp_path / name).mkdir()
        again.save(trial_file(tmp_path / name, 0))
    assert trial_file(tmp_path / "first", 0).read_bytes() == trial_file(tmp_path / "second", 0).read_bytes()


def test_the_summary_has_what_scripts_rely_on_and_says_what_is_modelled(trials):
    summary = summarise([trials["calibrated"][0]])
    keys = {"task", "variant", "method", "seed", "trials", "attempted", "succeeded", "success_rate", "success_ci95"}
    keys |= {"mean_time_s", "parts_s", "failures", "compute_ms", "missed_budgets", "realtime_factor", "versions"}
    assert keys <= set(summary)
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    assert any("no tissue mechanics" in sentence for sentence in summary["modelled"])
    assert summary["collisions_per_trial"] is None
    json.dumps(summary, allow_nan=False)


def test_a_plan_fills_in_its_tasks_options_and_refuses_those_of_others():
    plan = Plan("suture")
    assert (plan.variant, plan.preset, plan.direction, plan.sutures) == ("single-arm", "default", "best", 4)
    assert Plan().variant == "unilateral"
    assert not {"preset", "direction", "sutures"} & set(Plan().about())
    with pytest.raises(TrocarError, match="task 'peg-transfer' has no option 'preset'; drop --preset"):
        Plan(preset="default")
