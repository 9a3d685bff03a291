"""Whole suture trials: the effect of cables, the gain from compensation, and what the seed determines."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from trocar.eval.config import RunConfig
from trocar.eval.method import METHODS
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.trial import trial_file
from trocar.lab import station_text
from trocar.report.files import report_of
from trocar.report.summary import summarise
from trocar.tasks.suture.report.driven_sutures import joint_errors
from trocar.tasks.suture.task import CircleSutures

LOOKED_S = 8.0
WRIST = ("roll", "wrist_pitch", "wrist_yaw")


@pytest.fixture(scope="module")
def brisk():
    """Method ``brisk-NAME`` for each method: twice as fast, so that the tests are too."""
    for name, method in CircleSutures.methods.items():
        faster = {"driving_speed_m_s": 0.016}
        settings = partial(replace, method.make_settings(), **faster)
        METHODS.register(f"suture/brisk-{name}", replace(method, settings=settings))
    yield
    for name in CircleSutures.methods:
        METHODS.forget(f"suture/brisk-{name}")


class Played:
    """Trials of one suture, each played when it is first asked for."""

    def __init__(self, folder):
        self.folder, self.found = folder, {}
        self.stiff = folder / "stiff.toml"
        self.stiff.write_text(station_text("suture").replace('"psm1_grey"', '"stiff"'))

    def config(self, how):
        method, station = ("uncalibrated", str(self.stiff)) if how == "stiff" else (how, "")
        cell = {"station": station, "difficulty": "mild", "calibration": "joints" if how == "calibrated" else ""}
        return RunConfig(CircleSutures(sutures=1), method=f"brisk-{method}", seed=3, **cell)

    def __getitem__(self, how):
        if how not in self.found:
            config = self.config(how)
            prepared = prepare(config, 0, self.folder / how)
            self.found[how] = run_trial(config, prepared, 0), config, prepared
        return self.found[how]


@pytest.fixture(scope="module")
def played(brisk, tmp_path_factory):
    return Played(tmp_path_factory.mktemp("sutures"))


def summary_of(trial):
    return summarise([trial], report_of(trial))


def test_joints_that_follow_their_encoders_drive_the_suture_and_believed_encoders_do_not(played):
    """The laboratory is registered as well or badly in both: it is the cables that fail the suture."""
    stiff, believed = (summary_of(played[how][0]) for how in ("stiff", "uncalibrated"))
    assert (stiff["succeeded"], stiff["attempted"]) == (1, 1)
    assert (believed["succeeded"], believed["attempted"]) == (0, 1)
    for how in ("stiff", "uncalibrated"):
        assert np.degrees(np.abs(joint_errors(played[how][0])[:, :2])).max() < 0.5, "outer joints have no slack"
    for joint in WRIST:
        assert stiff["joint_error_deg"][joint]["rms"] < 0.3
        assert believed["joint_error_deg"][joint]["rms"] > 1.5
    assert stiff["tip_error_mm"]["max"] < 1.0
    assert believed["tip_error_mm"]["max"] > 1.5


def test_compensated_cables_drive_the_suture(played):
    calibrated, uncalibrated = (summary_of(played[how][0]) for how in ("calibrated", "uncalibrated"))
    assert (calibrated["succeeded"], calibrated["attempted"]) == (1, 1)
    for joint in WRIST:
        assert calibrated["joint_error_deg"][joint]["rms"] < 0.2 * uncalibrated["joint_error_deg"][joint]["rms"]
        assert calibrated["joint_error_deg"][joint]["rms"] < 1.5
    assert calibrated["tip_error_mm"]["max"] < 1.5


@pytest.mark.slow
def test_the_same_seed_writes_the_same_bytes(played, tmp_path):
    """Up to the moment at which the arm has looked at the needle, and drives it."""
    _, config, prepared = played["calibrated"]
    config = replace(config, task=replace(config.task, budget_s=LOOKED_S))
    files = []
    for name in ("first", "second"):
        files.append(trial_file(tmp_path / name, 0, 0))
        files[-1].parent.mkdir(parents=True)
        trial = run_trial(config, prepared, 0)
        trial.save(files[-1])
    assert any(span.name == "looking" for span in trial.spans)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_summary_has_what_scripts_rely_on_and_says_what_is_modelled(played):
    trial = played["uncalibrated"][0]
    summary = summary_of(trial)
    keys = {"task", "variant", "method", "seed", "trials", "attempted", "succeeded", "success_rate", "success_ci95"}
    keys |= {"mean_time_s", "parts_s", "failures", "compute_ms", "missed_budgets", "realtime_factor", "versions"}
    keys |= {"sessions", "collisions_per_trial", "command_limit_use", "flaws"}
    assert keys <= set(summary)
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    assert summary["variant"] == "single-arm" and summary["sutures"] == [
        {name: trial.scores[0][name] for name in ("theta_deg", "direction")}
    ]
    assert any("no tissue mechanics" in sentence for sentence in report_of(trial).notes([trial]))
    json.dumps(summary, allow_nan=False)


def test_the_trial_says_how_its_arm_was_driven(played):
    stiff, cables = (played[how][0] for how in ("stiff", "uncalibrated"))
    assert stiff.about["transmissions"] == {"psm1": "joints that follow their encoders exactly"}
    assert cables.about["transmissions"] != stiff.about["transmissions"]
    assert stiff.about["station_digest"] != cables.about["station_digest"]
    assert stiff.about["fingerprint"] != cables.about["fingerprint"]
    for trial in (stiff, cables):
        assert max(trial.command_limit_use["psm1"]) <= 1.0 + 1e-3
        assert trial.finished and trial.reason == "" and trial.about["model"] is None
