"""What every cable model has to do."""

import numpy as np
import pytest

from trocar.calibration.evaluation import refit_ends, refit_offset
from trocar.calibration.models import MODELS
from trocar.calibration.recording import Recording, load_recording
from trocar.calibration.study import LIMITS_RAD
from trocar.errors import InvalidInput, TrocarError
from trocar.testing import check_cable_model
from walks import walk


@pytest.mark.parametrize("name", MODELS)
def test_a_model_does_what_outsiders_are_told_that_a_cable_model_does(name, fitted):
    check_cable_model(name, fitted[name], tolerance=1e-6 if name == "lstm" else 1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_shows_itself_in_a_line(name, fitted):
    assert f"cable model {name!r}, fitted on 200 rows" in repr(fitted[name])


class Stiff:
    """A model without what is called later."""

    name = "stiff"

    @classmethod
    def fit(cls, recording, rng): ...


@pytest.mark.parametrize(
    ("name", "model", "words"),
    [
        ("stiff", None, "cable model 'stiff' is None; register a class with what a CableModel has"),
        ("stiff", Stiff(), "cable model 'stiff' is .*; register a class"),
        ("stiff", Stiff, "has no predict, start, step, shifted, arrays, from_arrays, rate_independent; give its class"),
        ("mine", MODELS["play"], "cable model 'mine' has the name 'play'; register it as 'play'"),
    ],
)
def test_what_is_no_cable_model_is_refused_when_it_is_registered(registries, name, model, words):
    with pytest.raises(InvalidInput, match=words):
        MODELS.register(name, model)


def last_fifth(recordings, name):
    recording = load_recording(recordings / f"dvrk/trajectories/{name}.npz")
    rows = int(0.8 * len(recording))
    return MODELS["play"].fit(recording.first(rows), np.random.default_rng(0)), recording, recording.scored(rows).valid


def wrist_rmse(model, recording, rows):
    return np.sqrt(np.mean((model.predict(recording.q_cmd) - recording.q_phy)[rows] ** 2, axis=0))[3:]


@pytest.mark.parametrize("name", ["psm2_grey_random", "psm1_new_random"])
def test_play_meets_its_limits_on_the_last_fifth(name, recordings):
    rmse = wrist_rmse(*last_fifth(recordings, name))
    assert np.all(rmse <= LIMITS_RAD[name]) and np.all(rmse > 0.42 * np.array(LIMITS_RAD[name])), rmse


def test_refitting_the_offsets_repairs_a_change_of_session(recordings):
    model, recording, rows = last_fifth(recordings, "psm1_grey_random")
    rmse, limits = wrist_rmse(model, recording, rows), np.array(LIMITS_RAD["psm1_grey_random"])
    assert np.all(rmse <= limits) and np.all(rmse > 0.42 * limits)
    other = load_recording(recordings / "dvrk/trajectories/psm1_grey_pick_place.npz")
    rows = other.scored(refit_ends(other)).valid
    before, after = (wrist_rmse(each, other, rows) for each in (model, refit_offset(model, other)))
    assert after[0] < 0.3 * before[0]
    assert np.all(after < (0.03, 0.055, 0.045))


def test_too_short_recordings_are_refused():
    q = walk(0, 20)
    short = Recording(q, q, np.ones(20, bool), np.arange(20.0))
    for kind in MODELS.values():
        with pytest.raises(TrocarError, match="30"):
            kind.fit(short, np.random.default_rng(0))
    with pytest.raises(TrocarError, match="more"):
        refit_offset(MODELS["offset"](np.zeros(6), None), short)
