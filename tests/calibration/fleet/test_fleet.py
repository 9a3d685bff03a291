"""A prior over instruments: what it gains after half a minute, on plants and on recordings."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from plant_models import recorded
from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import random_smooth_path, wide_path
from trocar.calibration.fleet import fit_from_prior, learn_prior, load_prior
from trocar.calibration.fleet.fit import ENOUGH_ROWS, OWN_ROWS
from trocar.calibration.fleet.prior import fit_loops
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import PLANTS, PSM2_GREY
from trocar.calibration.recording import Recording, load_recording

LIMITS_RAD = {
    ("psm1_grey_random", 50): (0.021, 0.040, 0.032),
    ("psm1_grey_random", 100): (0.016, 0.037, 0.026),
    ("psm1_grey_random", 200): (0.013, 0.029, 0.0215),
    ("psm2_grey_random", 50): (0.013, 0.039, 0.028),
    ("psm2_grey_random", 100): (0.013, 0.035, 0.027),
    ("psm2_grey_random", 200): (0.013, 0.0225, 0.021),
    ("psm1_new_random", 50): (0.020, 0.040, 0.038),
    ("psm1_new_random", 100): (0.016, 0.020, 0.016),
    ("psm1_new_random", 200): (0.014, 0.015, 0.015),
}
"""RMSE of q4 q5 q6 on the last fifth after so many rows: the project's targets, or what is reached where that is more
(docs/calibration.md has both). Without a prior seven of the nine are exceeded, by up to 2.4."""


@pytest.fixture(scope="module")
def prior():
    """Return what two plants show of all, the third unseen."""
    return learn_prior(
        [
            recorded(plant, np.random.default_rng(k), 300, f"{k}")
            for k, plant in enumerate(PLANTS.values())
            if plant is not PSM2_GREY
        ]
    )


@pytest.fixture(scope="module")
def mixed(prior):
    """Return a model of more rows than a minute's, and fewer than suffice by themselves."""
    model = fit_from_prior(recorded(PSM2_GREY, np.random.default_rng(7), ENOUGH_ROWS - 100), prior)
    assert model.training.rows > OWN_ROWS
    return model


def test_a_prior_is_worth_more_than_half_a_minute_of_recording(prior):
    """The plant is one that the prior never saw; it starts with slack, which the fit is not told."""
    rng = np.random.default_rng(5)
    q = random_smooth_path(PSM_CLASSIC, rng, 400)
    before = q[:1] + np.linspace(0.3, 0.0, 20)[:, None] * np.array([0, 0, 0, 1.0, -1.0, 1.0])  # it came from there
    joints = PSM2_GREY.run(np.concatenate([before, q]))[20:]
    recording = Recording(q, PSM2_GREY.measure(joints, rng), np.ones(400, bool), np.arange(400.0))

    def tail(model):
        return np.sqrt(np.mean((model.predict(q) - joints)[300:, 3:] ** 2, axis=0))

    with_prior = tail(fit_from_prior(recording.first(50), prior))
    without = tail(PlayModel.fit(recording.first(50), np.random.default_rng(0)))
    assert np.prod(with_prior) < 0.3 * np.prod(without)
    assert (with_prior < [0.02, 0.05, 0.05]).all()


def test_between_a_minute_and_enough_both_are_mixed(mixed):
    fresh = random_smooth_path(PSM_CLASSIC, np.random.default_rng(8), 200)
    error = (mixed.predict(fresh) - PSM2_GREY.run(fresh))[50:]
    assert (np.sqrt(np.mean(error**2, axis=0)) < [3e-4, 3e-4, 1e-4, 0.004, 0.012, 0.012]).all()


def test_half_a_minute_of_wide_swings_says_more_than_one_of_a_smooth_motion(prior):
    """On play operators; with what recordings show besides, see benchmarks/bench_excitation.py."""
    fresh = random_smooth_path(PSM_CLASSIC, np.random.default_rng(8), 300)
    true = PSM2_GREY.run(fresh)

    def rmse(path):
        noisy = PSM2_GREY.measure(PSM2_GREY.run(path), np.random.default_rng(3))
        recording = Recording(path, noisy, np.ones(len(path), bool), np.arange(float(len(path))))
        return np.sqrt(np.mean((fit_from_prior(recording, prior).predict(fresh) - true)[20:, 3:] ** 2, axis=0))

    smooth = rmse(random_smooth_path(PSM_CLASSIC, np.random.default_rng(9), 38))
    wide = rmse(wide_path(PSM_CLASSIC, 38))
    assert np.prod(wide) < 0.4 * np.prod(smooth)
    assert (wide < [0.008, 0.015, 0.015]).all()


def test_the_built_in_prior_is_what_its_recordings_show(recordings):
    """Of one; the others are fitted in the same way."""
    fits = {fit.name: fit for fit in load_prior("fleet").fits}
    assert len(fits) == 6
    found = fit_loops(load_recording(recordings / "dvrk/trajectories/psm1_new_random.npz"))
    assert found.name == "psm1_new_random"
    for key in ("shape", "weights", "outer", "left"):
        assert_allclose(getattr(found, key), getattr(fits[found.name], key), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("name", "rows"), LIMITS_RAD)
def test_instruments_that_the_prior_never_saw(name, rows, recordings):
    data = load_recording(recordings / f"dvrk/trajectories/{name}.npz")
    cut, others = int(0.8 * len(data)), load_prior("fleet").without(name.removesuffix("_random"))
    error = fit_from_prior(data.first(rows), others).predict(data.q_cmd) - data.q_phy
    rmse = np.sqrt(np.mean(error[cut:][data.valid[cut:]] ** 2, axis=0))
    assert (rmse[3:] <= LIMITS_RAD[name, rows]).all(), rmse


@pytest.mark.parametrize(
    ("name", "rows", "limits"),
    [("psm1_grey_pick_place", 75, (0.021, 0.024, 0.020)), ("psm1_grey_user_random", 300, (0.019, 0.055, 0.056))],
)
def test_another_session_of_an_instrument(name, rows, limits, recordings):
    """A constant alone leaves .017 .051 .036 of the first one."""
    prior = load_prior("fleet").without(name)
    data = load_recording(recordings / f"dvrk/trajectories/{name}.npz")
    last = int(np.flatnonzero(data.valid)[rows - 1]) + 1
    error = fit_from_prior(data.first(last), prior).predict(data.q_cmd) - data.q_phy
    rmse = np.sqrt(np.mean(error[last:][data.valid[last:]] ** 2, axis=0))
    assert (rmse[3:] <= limits).all(), rmse
