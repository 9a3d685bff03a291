"""A prior over instruments: what it gains after half a minute, on plants and on recordings."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import random_smooth_path, wide_path
from trocar.calibration.fleet import fit_from_prior, learn_prior, load_prior
from trocar.calibration.fleet.curve import WITH, WITHOUT, curve, draw_curve
from trocar.calibration.fleet.fit import ENOUGH_ROWS, OWN_ROWS
from trocar.calibration.fleet.loop_fit import fit_loops
from trocar.calibration.fleet.loops import LoopShape
from trocar.calibration.fleet.prior import FleetPrior
from trocar.calibration.models import load_model, save_model
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import PLANTS, PSM2_GREY
from trocar.calibration.play import play_operator
from trocar.calibration.recording import Recording, load_recording
from trocar.errors import TrocarError

OTHERS = {
    "psm1_grey_random": ("psm1_red_user_random", "psm2_grey_random", "psm1_new_random"),
    "psm2_grey_random": (
        "psm1_grey_random",
        "psm1_grey_pick_place",
        "psm1_grey_user_random",
        "psm1_red_user_random",
        "psm1_new_random",
    ),
    "psm1_new_random": (
        "psm1_grey_random",
        "psm1_grey_pick_place",
        "psm1_grey_user_random",
        "psm1_red_user_random",
        "psm2_grey_random",
    ),
}
"""Recordings of other instruments."""
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


@cache
def loops(path):
    return fit_loops(load_recording(path))


@cache
def learned(folder, names):
    """Return what `learn_prior` makes of these recordings, each of which is fitted once in all tests."""
    return FleetPrior.of([loops(folder / f"{name}.npz") for name in names])


def recorded(plant, seed, rows):
    rng = np.random.default_rng(seed)
    q = random_smooth_path(PSM_CLASSIC, rng, rows)
    return Recording(q, plant.measure(plant.run(q), rng), np.ones(rows, bool), 0.8 * np.arange(rows), f"seed{seed}")


@pytest.fixture(scope="module")
def prior():
    """Return what two plants show of all, the third unseen."""
    return learn_prior([recorded(plant, k, 300) for k, plant in enumerate(PLANTS.values()) if plant is not PSM2_GREY])


def test_slacks_from_any_start_are_those_of_play_operators():
    rng = np.random.default_rng(0)
    shape = LoopShape(np.array([0.03, 0.1, 0.12]), 0.1, 0.2)
    q = rng.normal(0, 0.2, (40, 6))
    starts = np.array([-1.0, 0.0, 0.5])
    slacks = shape.slacks(q, starts)
    u = q[:, 4] + 0.1 * q[:, 5]
    for s, start in enumerate(starts):
        for k, radius in enumerate(shape.banks[1]):
            assert_allclose(slacks[:, 1, s, k], u - play_operator(u, radius, u[0] - start * radius), atol=1e-12)


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


def test_many_rows_leave_nothing_to_the_prior(prior):
    recording = recorded(PSM2_GREY, 7, ENOUGH_ROWS)
    path = random_smooth_path(PSM_CLASSIC, np.random.default_rng(8), 100)
    alone = PlayModel.fit(recording, np.random.default_rng(0))
    assert_allclose(fit_from_prior(recording, prior).predict(path), alone.predict(path))


def test_between_a_minute_and_that_both_are_mixed(prior):
    recording = recorded(PSM2_GREY, 7, ENOUGH_ROWS - 100)
    model = fit_from_prior(recording, prior)
    assert model.training.rows > OWN_ROWS
    fresh = random_smooth_path(PSM_CLASSIC, np.random.default_rng(8), 200)
    error = (model.predict(fresh) - PSM2_GREY.run(fresh))[50:]
    assert (np.sqrt(np.mean(error**2, axis=0)) < [3e-4, 3e-4, 1e-4, 0.004, 0.012, 0.012]).all()


def test_the_model_is_kept_in_a_file_and_steps_as_it_predicts(prior, tmp_path):
    model = fit_from_prior(recorded(PSM2_GREY, 3, 260), prior)
    again = load_model(save_model(model, tmp_path / "m.npz"))
    q = random_smooth_path(PSM_CLASSIC, np.random.default_rng(1), 30)
    state, joints = again.start(q[0]), []
    for row in q:
        joint, state = again.step(state, row)
        joints.append(joint)
    assert_allclose(joints, model.predict(q), atol=1e-9)


def test_a_prior_is_kept_in_a_file(prior, tmp_path):
    again = load_prior(prior.save(tmp_path / "prior.npz"))
    assert again.sources == prior.sources
    assert_allclose(again.factors, prior.factors)


def test_the_built_in_prior_says_where_it_comes_from():
    assert len(load_prior("fleet").sources) == 6


def test_a_prior_can_leave_an_instrument_out():
    fleet = load_prior("fleet")
    left = fleet.without("psm1_grey")
    assert left.sources == ("psm1_red_user_random", "psm2_grey_random", "psm1_new_random")
    assert np.abs(left.shape_mean - fleet.shape_mean).max() > 0.05
    with pytest.raises(TrocarError, match="from 1 recordings"):
        left.without("psm2").without("psm1_new")


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


def test_a_file_that_is_no_prior_is_refused(tmp_path):
    with pytest.raises(TrocarError, match="does not exist"):
        load_prior(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"nonsense")
    with pytest.raises(TrocarError):
        load_prior(tmp_path / "bad.npz")


def test_one_recording_is_no_fleet():
    with pytest.raises(TrocarError, match="two or more"):
        learn_prior([recorded(PSM2_GREY, 0, 100)])


def test_the_curve_has_both_ways_and_a_picture(prior, tmp_path):
    found = curve(recorded(PSM2_GREY, 4, 200), prior, [50, 100])
    assert found.rmse[WITH].shape == found.rmse[WITHOUT].shape == (2, 6)
    assert found.tail == 40
    assert draw_curve(found, tmp_path / "curve.png").stat().st_size > 10_000
    with pytest.raises(TrocarError, match=r"outside 30\.\.160"):
        curve(recorded(PSM2_GREY, 4, 200), prior, [170])


@pytest.mark.parametrize(("name", "rows"), LIMITS_RAD)
def test_instruments_that_the_prior_never_saw(name, rows, recordings):
    other = learned(recordings / "dvrk/trajectories", OTHERS[name])
    data = load_recording(recordings / f"dvrk/trajectories/{name}.npz")
    cut = int(0.8 * len(data))
    error = fit_from_prior(data.first(rows), other).predict(data.q_cmd) - data.q_phy
    rmse = np.sqrt(np.mean(error[cut:][data.valid[cut:]] ** 2, axis=0))
    assert (rmse[3:] <= LIMITS_RAD[name, rows]).all(), rmse


@pytest.mark.parametrize(
    ("name", "rows", "limits"),
    [
        ("psm1_grey_pick_place", 75, (0.021, 0.024, 0.020)),
        ("psm1_grey_user_random", 300, (0.019, 0.055, 0.056)),
    ],
)
def test_another_session_of_an_instrument(name, rows, limits, recordings):
    """A constant alone leaves .017 .051 .036 of the first one."""
    folder = recordings / "dvrk/trajectories"
    prior = learned(folder, tuple(path.stem for path in sorted(folder.glob("*.npz")) if path.stem != name))
    data = load_recording(folder / f"{name}.npz")
    last = int(np.flatnonzero(data.valid)[rows - 1]) + 1
    error = fit_from_prior(data.first(last), prior).predict(data.q_cmd) - data.q_phy
    rmse = np.sqrt(np.mean(error[last:][data.valid[last:]] ** 2, axis=0))
    assert (rmse[3:] <= limits).all(), rmse
