"""Every fault has a name, both arms come to rest, and the trial is saved."""

import numpy as np
import pytest

from debridement_stage import Eyes, play
from trocar.eval.trial import Trial
from trocar.tasks.debridement.goals import FragmentOutcome

RESTING = 1e-4
"""Change of a joint (rad, m) in the last tick; at the limit of acceleration the last step of braking is half of it."""


def outcomes(trial, arm=None):
    return [e["outcome"] for e in trial.events if e["name"] == "fragment" and arm in (None, e["arm"])]


def done(trial):
    return sum(score["succeeded"] for score in trial.scores)


def still(trial, arm):
    """Return whether an arm is at rest at the end: its last two commands are the same but for the end of a ramp."""
    rows = trial.arrays[f"commanded_{arm}"][:, :6]
    return np.abs(rows[-1] - rows[-2]).max() < RESTING


def test_a_camera_that_freezes_ends_the_trial_where_the_arms_are(monkeypatch, tmp_path):
    eyes = Eyes()
    eyes.frozen_s = 3.0
    trial = play(monkeypatch, tmp_path, eyes, fragments=2, budget_s=60.0)
    assert outcomes(trial)[-2:] == [FragmentOutcome.CAMERA_FROZEN.name] * 2
    assert trial.duration_s < 12.0 and done(trial) == 0
    assert still(trial, "left") and still(trial, "right")
    trial.save(tmp_path / "trial.npz")
    assert Trial.load(tmp_path / "trial.npz").events == trial.events


def test_an_arm_that_stops_leaves_the_other_one_to_finish(monkeypatch, tmp_path):
    def stop_left(lab):
        tick = lab.driver.tick

        def ticked(now_s):
            if now_s > 4.0 and lab.driver.setpoint("left").moving:
                lab.driver.fault("left", reason="left does not answer")
            tick(now_s)

        monkeypatch.setattr(lab.driver, "tick", ticked)

    trial = play(monkeypatch, tmp_path, Eyes(), robot=stop_left, fragments=2, budget_s=150.0)
    assert outcomes(trial, "left")[-1] == FragmentOutcome.ARM_STOPPED.name
    assert outcomes(trial, "right").count("DONE") >= 1
    assert not any(c["against"] in ("left", "right") for c in trial.collisions)
    assert still(trial, "left") and still(trial, "right")


def test_marks_that_are_hidden_for_three_seconds_cost_time_only(monkeypatch, tmp_path):
    eyes = Eyes()
    eyes.hidden = (("left", 2.5, 5.5), ("right", 3.0, 6.0))
    trial = play(monkeypatch, tmp_path, eyes, fragments=2, budget_s=120.0)
    assert trial.ended == "done" and done(trial) == 2
    assert still(trial, "left") and still(trial, "right")


@pytest.mark.slow
def test_a_fragment_that_an_arm_hides_while_it_lets_go_is_not_forgotten(monkeypatch, tmp_path):
    class Hiding(Eyes):
        """An arm over the receptacle hides all fragments that still lie outside."""

        def fragments(self, *args, **kwargs):
            found = super().fragments(*args, **kwargs)
            over = self.tip("left").translation_m[1] > -0.012
            return [f for f in found if f.p_world_m[1] > -0.03] if over and self.lab.now_s() > 5.0 else found

    trial = play(monkeypatch, tmp_path, Hiding(), arms=1, fragments=2, budget_s=120.0)
    assert trial.ended == "done" and done(trial) == 2
