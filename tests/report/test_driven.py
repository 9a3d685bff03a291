"""Driven sutures in numbers, on trials made up for it."""

import numpy as np
import pytest

from trocar.report.driven import driven_summary, joint_errors, limits_shown, primitive_times
from trocar.report.driven_figures import draw_joints, draw_needle
from trocar.sutures import PRESETS
from trocar.sutures.primitive import needle_poses
from trocar.tasks import CircleSutures
from trocar.trials import Trial

STEPS = ("approach", "penetrate", "rotate", "regrasp 1", "push 1", "withdraw")
OFF = np.radians([0.1, -0.2, 0.0, 1.0, 2.0, -3.0]) + [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]
(SUTURE,) = CircleSutures(sutures=1).work


def made_up(off=OFF, failure=""):
    """Return a trial of one suture whose joints are ``off`` their plan while the primitive runs, and far off else."""
    times = np.round(0.01 * np.arange(1, 701), 6)
    asked = np.outer(np.sin(times), np.linspace(0.1, 0.6, 6))
    runs = (times >= 1.0) & (times <= 5.0)
    needle = SUTURE.turned(needle_poses(SUTURE.setup, np.linspace(0.0, 0.01, 700), 0.0)).matrix
    score = {
        **{"theta_deg": float(np.degrees(SUTURE.theta_rad)), "direction": SUTURE.direction, "attempted": True},
        **{"succeeded": not failure, "failure": failure, "reason": "why", "start_s": 0.0, "end_s": 6.0, "steps": 4},
        **{"entry_error_m": 1e-4, "exit_error_m": None, "tip_rms_m": 2e-4, "tip_max_m": 3e-4, "slip_m": 5e-5},
        "slip_rad": 0.0,
    }
    return Trial(
        about={"task": "suture", "preset": "default", "sutures": 2, "settings": {"arm": "psm1"}},
        transfers=[score],
        spans=[],
        events=[{"name": "step", "suture": 0, "step": step, "time_s": float(k)} for k, step in enumerate(STEPS)],
        collisions=[],
        finished=True,
        duration_s=7.0,
        arrays={
            "truth_s": times,
            "joints_psm1": asked + np.where(runs[:, None], off, 1.0),
            "asked_s_psm1": times[::2],
            "asked_psm1": asked[::2],
            "needle": needle.astype(np.float32),
        },
    )


def test_joint_errors_count_while_the_primitive_runs_and_only_then():
    trial = made_up()
    assert primitive_times(trial, 0) == (1.0, 5.0)
    errors = joint_errors(trial)
    np.testing.assert_allclose(errors, np.broadcast_to(OFF, errors.shape), atol=1e-4)
    summary = driven_summary([trial, trial])
    assert summary["joint_error_deg"]["wrist_pitch"]["rms"] == pytest.approx(2.0, abs=0.01)
    assert summary["joint_error_deg"]["wrist_yaw"]["max"] == pytest.approx(3.0, abs=0.01)
    assert summary["insertion_error_mm"]["rms"] == pytest.approx(1.0, abs=0.01)
    assert "insertion" not in summary["joint_error_deg"]


def test_what_was_not_measured_is_none_and_what_was_not_begun_is_counted():
    summary = driven_summary([made_up(failure="JOINT_LIMIT")])
    assert summary["exit_error_mm"] == {"mean": None, "max": None}
    assert summary["entry_error_mm"]["max"] == pytest.approx(0.1)
    assert summary["not_attempted"] == 1
    assert summary["stopped"] == ["why"]
    assert driven_summary([made_up()])["stopped"] == []


def test_limits_are_shown_in_degrees_and_millimetres():
    arm = PRESETS["default"].setup.arm
    assert limits_shown(arm, 4)[:2] == pytest.approx((-80.0, 80.0))
    assert limits_shown(arm, 2) == (0.0, pytest.approx(240.0), 1e3, "mm")


@pytest.mark.parametrize("draw", [draw_joints, draw_needle])
def test_pictures_are_drawn(draw, tmp_path):
    assert draw(made_up(), tmp_path / "picture.png").stat().st_size > 20_000
