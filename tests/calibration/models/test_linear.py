"""A constant error, windows, and a linear map from them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trocar.calibration.models import OffsetModel, RidgeModel
from trocar.calibration.models.linear import resting_window, windows
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk


def test_the_offset_is_the_mean_error_of_the_good_rows():
    rng, q = np.random.default_rng(0), walk(0, 60)
    error, valid = rng.normal(0.1, 0.2, (60, 6)), rng.random(60) > 0.3
    model = OffsetModel.fit(Recording(q, q + error, valid, np.arange(60.0)), rng)
    assert_allclose(model.offset, error[valid].mean(axis=0), atol=1e-12)
    assert_allclose(model.predict(q), q + error[valid].mean(axis=0), atol=1e-12)


def test_it_shows_the_wrists_offsets_in_degrees():
    q = walk(0, 40)
    error = np.tile([0.5, 0.6, 0.7, *np.radians([3.0, -1.5, 0.25])], (40, 1))
    model = OffsetModel.fit(Recording(q, q + error, np.ones(40, bool), np.arange(40.0)), np.random.default_rng(0))
    assert repr(model) == "<cable model 'offset', fitted on 40 rows: offsets of q4 q5 q6 3.00, -1.50, 0.25 deg>"


def test_an_offset_is_six_numbers():
    assert OffsetModel.from_arrays({"offset": np.arange(6.0)}, None).offset.tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.raises(TrocarError, match="has shape"):
        OffsetModel.from_arrays({"offset": np.zeros(1)}, None)


Q = np.arange(10.0)[:, None] + 100.0 * np.arange(6)


def test_a_window_is_a_command_after_the_five_before_it():
    found = windows(Q)
    assert found.shape == (10, 6, 6)
    assert_array_equal(found[5], Q[:6])
    assert_array_equal(found[9], Q[4:])


def test_before_its_first_command_an_arm_has_been_at_rest():
    assert_array_equal(windows(Q)[0], np.tile(Q[0], (6, 1)))
    assert_array_equal(windows(Q)[2], Q[[0, 0, 0, 0, 1, 2]])
    assert_array_equal(resting_window(Q[0]), np.tile(Q[0], (5, 1)))


RNG = np.random.default_rng(0)


def made(q, error, valid=None):
    return Recording(q, q + error, np.ones(len(q), bool) if valid is None else valid, np.arange(float(len(q))))


def test_it_is_a_ridge_regression_on_standardised_windows():
    """As if for each weight one more sample said that it is zero."""
    q = RNG.normal(0, [0.1, 0.2, 0.02, 0.3, 0.4, 0.5], (60, 6)) + 0.3
    error = RNG.normal(0, 0.05, (60, 6)) + 0.1
    valid = RNG.random(60) > 0.3
    model = RidgeModel.fit(made(q, error, valid), RNG)
    x, y = windows(q).reshape(60, 36)[valid], error[valid]
    z = (x - x.mean(axis=0)) / x.std(axis=0)
    more = np.vstack([z, np.eye(36)])
    weights = np.linalg.lstsq(more, np.vstack([y - y.mean(axis=0), np.zeros((36, 6))]), rcond=None)[0]
    assert_allclose((model.predict(q) - q)[valid], y.mean(axis=0) + z @ weights, atol=1e-9)
    assert model.training.rows == valid.sum()


def test_errors_that_hang_on_the_last_commands_are_found():
    q = RNG.normal(0, 0.3, (800, 6))
    lag = np.vstack([q[:1], q[:1], q[:-2]])
    error = 0.2 * q[:, [3, 4, 5, 0, 1, 2]] - 0.1 * lag + 0.05
    model = RidgeModel.fit(made(q, error), RNG)
    fresh = RNG.normal(0, 0.3, (50, 6))
    lag = np.vstack([fresh[:1], fresh[:1], fresh[:-2]])
    assert_allclose(model.predict(fresh) - fresh, 0.2 * fresh[:, [3, 4, 5, 0, 1, 2]] - 0.1 * lag + 0.05, atol=1e-3)


@pytest.mark.parametrize(("moves_by", "weighs"), [(0.0, False), (1e-6, True)])
def test_a_joint_that_never_moved_has_no_weight(moves_by, weighs):
    q = RNG.normal(0, 0.3, (100, 6))
    q[:, 2] = 0.15 + moves_by * RNG.normal(size=100)
    model = RidgeModel.fit(made(q, 0.1 * q), RNG)
    weights = model.weights.reshape(6, 6, 6)[:, 2]
    assert np.isfinite(weights).all() and weights.any() == weighs
    assert np.isfinite(model.offset).all()


def test_arrays_of_another_window_are_refused():
    q = RNG.normal(0, 0.3, (60, 6))
    model = RidgeModel.fit(made(q, 0.3 * q), RNG)
    again = RidgeModel.from_arrays(model.arrays(), model.training)
    assert_allclose(again.predict(q), model.predict(q))
    for wrong in ({"weights": np.zeros((36, 5))}, {"weights": np.zeros((42, 6))}, {"offset": np.zeros(7)}):
        with pytest.raises(TrocarError, match="has shape"):
            RidgeModel.from_arrays(model.arrays() | wrong, model.training)
