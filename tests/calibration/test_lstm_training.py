"""The paper's network is trained; JAX is loaded where that is tested, for it takes seconds."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.calibration.models.lstm import dense, remember


def examples(rng, n):
    """Return windows (n, 6, 6) and targets (n, 2) that depend on the last command and the one before it."""
    x = rng.normal(size=(n, 6, 6))
    return x, np.tanh(np.column_stack([x[:, -1, 3] + x[:, -2, 4], x[:, -1, 5] - x[:, -2, 4]]))


@pytest.fixture(scope="module")
def trained():
    """Return a small network and its weights; it learns in seconds what takes the paper's many minutes."""
    from trocar.calibration import lstm_training

    networks, arrays = [], lstm_training._arrays
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("EPOCHS", 150), ("LEARNING_RATE", 1e-2), ("BATCH", 32)):
            patch.setattr(lstm_training, name, value)
        patch.setattr(lstm_training, "_arrays", lambda network: networks.append(network) or arrays(network))
        weights = lstm_training.train(*examples(np.random.default_rng(1), 4 * 32 + 7), 8, np.random.default_rng(0))
    return networks[0], weights


@pytest.mark.slow
def test_the_network_in_numpy_is_the_one_that_was_trained(trained):
    import equinox as eqx

    network, weights = trained
    z, _ = examples(np.random.default_rng(0), 20)
    ours = dense(weights, remember(weights, z.astype(np.float32))[0])
    assert_allclose(ours, np.asarray(eqx.filter_jit(eqx.filter_vmap(network))(z)), atol=1e-5)
    assert all(value.dtype == np.float32 for value in weights.values())


@pytest.mark.slow
def test_training_learns_what_depends_on_the_past(trained):
    x, y = examples(np.random.default_rng(2), 200)
    predicted = dense(trained[1], remember(trained[1], x.astype(np.float32))[0])
    assert np.sqrt(np.mean((predicted - y) ** 2)) < 0.6 * y.std()


@pytest.mark.slow
def test_commands_are_noisy_in_training_those_of_the_outer_joints_most(monkeypatch):
    """So that the network cannot tell the moment of the recording by where the outer joints are."""
    from trocar.calibration import lstm_training

    seen, jnp = [], lstm_training.jnp
    noting = SimpleNamespace(**vars(jnp))
    noting.asarray = lambda given: seen.append(given) or jnp.asarray(given)
    monkeypatch.setattr(lstm_training, "jnp", noting)
    monkeypatch.setattr(lstm_training, "EPOCHS", 1)
    x = np.tile(np.arange(6.0), (2048, 4, 1))
    lstm_training.train(x, np.zeros((2048, 2)), 4, np.random.default_rng(0))
    noise = (next(given for given in seen if given.shape[-2:] == (4, 6)) - np.arange(6.0)).reshape(-1, 6)
    assert_allclose(noise.mean(axis=0), 0.0, atol=0.03)
    assert_allclose(noise.std(axis=0), [0.7] * 3 + [0.05] * 3, rtol=0.05)
