"""The emergency stop at random times of real trials in which two arms move."""

import numpy as np
import pytest

from braking import rest_and_brake_s
from trocar.console import Watch
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.wishes import Said, Wish

WHOLE_S = 8.0
"""A time before the end of each of these trials."""


class Pressed(Watch):
    """A console without a page, at which the emergency stop is pressed at a time of the cell's clock."""

    def __init__(self, at_s):
        super().__init__(speed=0.0, port=None)
        self._at_s = at_s

    def _hear(self):
        due = self.console.cell is not None and self.console.now_s >= self._at_s and not self.ended
        return [Said(Wish.EMERGENCY)] if due else []


def stopped(variant, at_s, folder):
    """Press the emergency stop at a time of a trial.

    Returns:
        The trial, the time in s that its arms took to rest, and the time that their limits make them take.
    """
    config = RunConfig(PegTransfer(variant=variant, transfers=2), method="uncalibrated", seed=3)
    prepared = prepare(config, 0, folder)
    with Pressed(at_s) as watch:
        trial = run_trial(config, prepared, 0, attendant=watch)
    (pressed_s,) = [event["time_s"] for event in trial.events if event["name"] == "person"]
    return trial, *rest_and_brake_s(trial, prepared.session.station.limits, pressed_s)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["handover", "bilateral"])
@pytest.mark.parametrize("seed", range(3))
def test_two_arms_rest_as_soon_as_their_limits_allow_whenever_the_emergency_stop_is_pressed(variant, seed, tmp_path):
    trial, rest_s, brake_s = stopped(variant, np.random.default_rng(seed).uniform(0.0, WHOLE_S), tmp_path)
    assert (trial.ended, trial.reason) == ("FAULT", "a person pressed the emergency stop")
    assert rest_s <= brake_s + 0.1
    assert max(max(use) for use in trial.command_limit_use.values()) <= 1.001
