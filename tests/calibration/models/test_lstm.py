import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.models import LstmModel, TrainingMotion
from trocar.calibration.models import lstm as module
from trocar.calibration.models.linear import windows
from trocar.calibration.models.lstm import dense, recur, remember
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from walks import walk


@pytest.fixture
def weights():
    """A network of three units whose weights are large enough for all its bends to show."""
    rng = np.random.default_rng(0)
    shapes = {"input": (12, 6), "recurrent": (12, 3), "bias": (12,), "dense1": (3, 3), "bias1": (3,)}
    shapes |= {"dense2": (3, 3), "bias2": (3,), "out": (6, 3), "bias_out": (6,)}
    return {key: rng.normal(0, 1.0, shape) for key, shape in shapes.items()}


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def by_the_textbook(weights, window):
    """Return hidden and cell after a window (steps, 6), unit by unit; gates in the order i f g o."""
    h, c = np.zeros(3), np.zeros(3)
    for z in window:
        gates = weights["input"] @ z + weights["recurrent"] @ h + weights["bias"]
        i, f, g, o = gates[:3], gates[3:6], gates[6:9], gates[9:]
        c = sigmoid(f) * c + sigmoid(i) * np.tanh(g)
        h = sigmoid(o) * np.tanh(c)
    return h, c


def test_the_recurrent_layer_is_that_of_the_textbook(weights):
    z = np.random.default_rng(1).normal(size=(4, 5, 6))
    hidden, cell = remember(weights, z)
    for k in range(4):
        h, c = by_the_textbook(weights, z[k])
        assert_allclose(hidden[k], h, atol=1e-6)
        assert_allclose(cell[k], c, atol=1e-6)
    once_more = recur(weights, z[0, 0], (hidden[0], cell[0]))
    assert_allclose(once_more[0], by_the_textbook(weights, np.vstack([z[0], z[0, :1]]))[0], atol=1e-6)


def test_the_dense_layers_let_only_positive_signals_through(weights):
    hidden = np.random.default_rng(2).normal(size=(20, 3))
    for h, found in zip(hidden, dense(weights, hidden), strict=True):
        one = weights["dense1"] @ h + weights["bias1"]
        two = weights["dense2"] @ np.where(one > 0, one, 0) + weights["bias2"]
        assert_allclose(found, weights["out"] @ np.where(two > 0, two, 0) + weights["bias_out"], atol=1e-12)


def test_a_fit_standardises_what_the_network_sees_and_undoes_it(weights, monkeypatch):
    """On recorded windows of good rows, whatever the network is."""
    seen = {}

    def train(x, y, hidden, rng):
        seen.update(x=x, y=y, hidden=hidden, rng=rng)
        return weights

    monkeypatch.setitem(sys.modules, "trocar.calibration.lstm_training", SimpleNamespace(train=train))
    rng = np.random.default_rng(3)
    q = walk(0, 60) + 0.5
    q[:, 2] = 0.2  # it never moves
    error, valid = 0.1 + 0.05 * rng.normal(size=(60, 6)), rng.random(60) > 0.3
    error[:, 1] = 0.3  # it never changes
    model = LstmModel.fit(Recording(q, q + error, valid, np.arange(60.0)), rng)
    assert seen["hidden"] == 256 and seen["rng"] is rng
    present = q[valid]
    moving = np.delete(np.arange(6), 2)
    assert_allclose(seen["x"][:, -1].mean(axis=0), 0.0, atol=1e-9)
    assert_allclose(seen["x"][:, -1, moving].std(axis=0), 1.0)
    assert not seen["x"][:, :, 2].round(9).any()
    assert_allclose(seen["x"] * model.input_scale + model.input_mean, windows(q)[valid], atol=1e-12)
    assert_allclose(model.input_mean, present.mean(axis=0))
    assert_allclose(seen["y"] * model.error_scale + model.offset, error[valid], atol=1e-12)
    varying = np.delete(np.arange(6), 1)
    assert_allclose(seen["y"].mean(axis=0), 0.0, atol=1e-9)
    assert_allclose(seen["y"][:, varying].std(axis=0), 1.0)
    assert model.input_scale[2] == 1.0 and model.error_scale[1] == 1.0
    assert model.training.rows == valid.sum()
    # What it then predicts: the command, the mean error, and the network's share of its SD.
    h, _ = by_the_textbook(weights, (windows(q)[30] - model.input_mean) / model.input_scale)
    expected = q[30] + model.offset + model.error_scale * dense(weights, h)
    assert_allclose(model.predict(q)[30], expected, atol=1e-6)


def test_a_joint_that_hardly_moves_is_told_from_one_that_rests():
    assert_allclose(module._scale(np.array([[0.0, 0.0], [0.0, 4e-9]])), [1.0, 2e-9])


def test_without_the_framework_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "trocar.calibration.lstm_training", None)
    q = walk(0, 40)
    with pytest.raises(TrocarError, match=r"training 'lstm' needs .*learn"):
        LstmModel.fit(Recording(q, q, np.ones(40, bool), np.arange(40.0)), np.random.default_rng(0))


def test_a_file_may_not_hold_a_network_of_another_size(fitted):
    model = fitted["lstm"]
    arrays = model.arrays()
    again = LstmModel.from_arrays(arrays, model.training)
    for key in ("input_mean", "input_scale", "error_scale", "offset"):
        assert_allclose(getattr(again, key), getattr(model, key))
    for key, value in model.weights.items():
        assert again.weights[key].dtype == np.float32 and np.array_equal(again.weights[key], value)
        with pytest.raises(TrocarError, match=f"'weight_{key}' has shape"):
            LstmModel.from_arrays(arrays | {f"weight_{key}": value[:-1]}, model.training)
    for key in ("input_mean", "input_scale", "error_scale", "offset"):
        with pytest.raises(TrocarError, match=f"'{key}' has shape"):
            LstmModel.from_arrays(arrays | {key: np.ones(7)}, model.training)


def test_a_state_is_the_last_five_commands(fitted):
    model, q = fitted["lstm"], walk(3, 9)
    state = model.start(q[0])
    assert_allclose(state.prior, np.tile(q[0], (5, 1)))
    for row in q[1:]:
        _, state = model.step(state, row)
    assert_allclose(state.prior, q[-5:])
    assert isinstance(model.training, TrainingMotion)
