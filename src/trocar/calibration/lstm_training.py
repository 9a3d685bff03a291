"""Training of the paper's network in jax: the only file that imports the framework (extra ``learn``)."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

EPOCHS = 40
BATCH = 64
LEARNING_RATE = 1e-3
WEIGHT_DECAY = 0.1


class Network(eqx.Module):
    """LSTM over a window, then two dense layers and a linear one (paper, section IV-A)."""

    cell: eqx.nn.LSTMCell
    dense1: eqx.nn.Linear
    dense2: eqx.nn.Linear
    out: eqx.nn.Linear

    def __init__(self, inputs: int, hidden: int, outputs: int, key: jax.Array):
        keys = jax.random.split(key, 4)
        self.cell = eqx.nn.LSTMCell(inputs, hidden, key=keys[0])
        self.dense1 = eqx.nn.Linear(hidden, hidden, key=keys[1])
        self.dense2 = eqx.nn.Linear(hidden, hidden, key=keys[2])
        self.out = eqx.nn.Linear(hidden, outputs, key=keys[3])

    def __call__(self, window: jax.Array) -> jax.Array:
        """Return the output (outputs,) for one window (steps, inputs)."""
        zero = jnp.zeros(self.cell.hidden_size)
        (hidden, _), _ = jax.lax.scan(lambda carry, z: (self.cell(z, carry), None), (zero, zero), window)
        layer = jax.nn.relu(self.dense1(hidden))
        return self.out(jax.nn.relu(self.dense2(layer)))


def train(
    x: NDArray[np.float64], y: NDArray[np.float64], hidden: int, rng: np.random.Generator
) -> dict[str, NDArray[np.float32]]:
    """Return the weights of the network trained on windows (n, steps, 6) and targets (n, 6), MSE, AdamW."""
    network = Network(x.shape[2], hidden, y.shape[1], jax.random.key(int(rng.integers(2**31))))
    batch = min(BATCH, len(x))
    per_epoch = len(x) // batch
    schedule = optax.cosine_decay_schedule(LEARNING_RATE, EPOCHS * per_epoch)
    optimiser = optax.adamw(schedule, weight_decay=WEIGHT_DECAY)
    state = optimiser.init(eqx.filter(network, eqx.is_array))

    def loss(network: Network, z: jax.Array, target: jax.Array) -> jax.Array:
        return jnp.mean((jax.vmap(network)(z) - target) ** 2)

    @eqx.filter_jit
    def epoch(network: Network, state: optax.OptState, z: jax.Array, target: jax.Array):
        arrays, static = eqx.partition(network, eqx.is_array)

        def update(carry, data):
            arrays, state = carry
            network = eqx.combine(arrays, static)
            gradient = eqx.filter_grad(loss)(network, *data)
            updates, state = optimiser.update(gradient, state, arrays)
            return (eqx.apply_updates(arrays, updates), state), None

        (arrays, state), _ = jax.lax.scan(update, (arrays, state), (z, target))
        return eqx.combine(arrays, static), state

    for _ in range(EPOCHS):
        rows = rng.permutation(len(x))[: per_epoch * batch].reshape(per_epoch, batch)
        network, state = epoch(network, state, jnp.asarray(x[rows]), jnp.asarray(y[rows]))
    return _arrays(network)


def _arrays(network: Network) -> dict[str, NDArray[np.float32]]:
    """Return the weights by the names that the NumPy network uses; both order the gates i f g o."""
    leaves = {
        "input": network.cell.weight_ih,
        "recurrent": network.cell.weight_hh,
        "bias": network.cell.bias,
        "dense1": network.dense1.weight,
        "bias1": network.dense1.bias,
        "dense2": network.dense2.weight,
        "bias2": network.dense2.bias,
        "out": network.out.weight,
        "bias_out": network.out.bias,
    }
    return {name: np.ascontiguousarray(leaf, dtype=np.float32) for name, leaf in leaves.items()}
