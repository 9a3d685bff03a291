"""An arm that learns its cables from looks at its wrist, in the cell `recorded`."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.tasks.peg_transfer.task import PegTransfer

ARM = "psm1"


def config(**options):
    return RunConfig(PegTransfer(transfers=2), method="adaptive", difficulty="recorded", seed=5, **options)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    run = config()
    return run_trial(run, prepare(run, 0, tmp_path_factory.mktemp("adaptive")), 0)


def errors_at(trial, time_s):
    at = round(time_s / trial.scenery.tick_s)
    return (trial.arrays[f"true_{ARM}"] - trial.arrays[f"desired_{ARM}"])[at, 3:6]


@pytest.mark.slow
def test_without_a_recording_blocks_are_moved(trial):
    assert [score["succeeded"] for score in trial.scores] == [True, True]
    assert trial.about["prior"] == "fleet" and trial.about["calibration"] is None


@pytest.mark.slow
def test_looks_before_the_first_transfer_leave_a_fraction_of_the_errors(trial):
    (first, *_) = [event["start_s"] for event in trial.events if event["name"] == "transfer"]
    assert 15.0 < first < 40.0, "the looks count"
    assert np.abs(errors_at(trial, 0.5)).max() > 0.1
    assert np.abs(errors_at(trial, first)).max() < 0.1


@pytest.mark.slow
def test_it_knows_how_far_off_it_may_be(trial):
    looks = [event for event in trial.events if event["name"] == "wrist seen"]
    assert len(looks) >= 2 and any(event["accepted"] for event in looks)
    for event in looks:
        before = errors_at(trial, event["time_s"] - 2 * trial.scenery.tick_s)
        assert (np.abs(before) < 3.5 * np.array(event["spread_rad"])).all()


def test_what_does_not_go_with_learning_is_refused():
    with pytest.raises(TrocarError, match="learns model 'play', not 'lstm'; drop --model"):
        config(model="lstm")
    with pytest.raises(TrocarError, match="no_such_file"):
        config(prior="no_such_file.npz")
