"""What an arm does while moving on: lift, and check the pickup."""

import numpy as np

from debridement_stage import Eyes, play
from trocar.arms import fk
from trocar.tasks.debridement.agents.settings import best

LIFT_M = best().lift_m
HIDDEN_S = 1.6


def times(trial, name):
    return [e["time_s"] for e in trial.events if e["name"] == name]


def tips_m(trial, arm):
    scenery = trial.scenery
    q = trial.arrays[f"true_{arm}"][:, :6].astype(float)
    return (scenery.T_world_base[arm] @ fk(scenery.arms[arm], q)).translation_m


def test_an_arm_lifts_straight_up_and_goes_on_without_a_stop(monkeypatch, tmp_path):
    trial = play(monkeypatch, tmp_path, Eyes(), arms=1, fragments=1, budget_s=60.0)
    first, last = (round(100 * times(trial, name)[0]) for name in ("closing", "releasing"))
    tip = tips_m(trial, "left")[first:last]
    assert np.linalg.norm(tip[-1, :2] - tip[0, :2]) > 0.03, "the receptacle is elsewhere"
    lifted = int(np.flatnonzero(tip[:, 2] > tip[0, 2] + LIFT_M)[0])
    assert np.linalg.norm(tip[lifted, :2] - tip[0, :2]) < 0.5 * LIFT_M
    leaves = int(np.flatnonzero(tip[:, 2] > tip[0, 2] + 0.2 * LIFT_M)[0])
    arrives = int(np.flatnonzero(np.linalg.norm(tip - tip[-1], axis=-1) < 0.02)[0])
    speeds = np.linalg.norm(tip[leaves + 10 : arrives] - tip[leaves : arrives - 10], axis=-1) / 0.1
    assert speeds.min() > 0.005, "m/s"


def test_jaws_that_are_hidden_are_not_taken_to_be_empty(monkeypatch, tmp_path):
    class Crossed(Eyes):
        """Something passes before the jaws, and what they hold, just after they have closed."""

        def crossed(self):
            closed = [e["time_s"] for e in self.lab.log.events if e["name"] == "closing"]
            return bool(closed) and self.lab.now_s() - closed[-1] < HIDDEN_S

        def gripper(self, *args):
            return None if self.crossed() else super().gripper(*args)

        def holding(self, *args):
            return not self.crossed() and super().holding(*args)

    trial = play(monkeypatch, tmp_path, Crossed(), arms=1, fragments=1, budget_s=60.0)
    (said,) = [e for e in trial.events if e["name"] == "pickup"]
    assert said["holding"]
    assert said["image_s"] > times(trial, "closing")[0] + HIDDEN_S - 0.1
    assert trial.scores[0]["first_attempt"]
