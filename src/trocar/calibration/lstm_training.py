"""Training of the paper's network with JAX; the only module that imports it (extra ``learn``)."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from trocar.geometry.arrays import Array

EPOCHS = 60
BATCH = 64
LEARNING_RATE = 1e-3
WEIGHT_DECAY = 0.1
AVERAGING = 0.99  # weight of the past, per update, in the running average of the parameters, which is returned
JITTER = np.array([0.7, 0.7, 0.7, 0.05, 0.05, 0.05])
"""SD of the noise added to the standardised commands q1 to q6 in training. The outer joints do not move the wrist's
cables; without much noise on them, the network recognises the moment of the recording instead of learning the motion.
Chosen on the last quarter of the first four fifths of three recordings."""


class Network(eqx.Module):
    """LSTM over a window, two dense layers and a linear layer (paper, section IV-A)."""

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


def train(x: Array, y: Array, hidden: int, rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
    """Return the averaged weights of a network trained on windows (n, steps, 6) and targets (n, 6): MSE, AdamW."""
    network = Network(x.shape[2], hidden, y.shape[1], jax.random.key(int(rng.integers(2**31))))
    batch = min(BATCH, len(x))
    per_epoch = len(x) // batch
    optimiser = optax.adamw(LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    arrays, static = eqx.partition(network, eqx.is_array)
    carry = (arrays, arrays, optimiser.init(arrays))

    def loss(network: Network, z: jax.Array, target: jax.Array) -> jax.Array:
        return jnp.mean((jax.vmap(network)(z) - target) ** 2)

    def update(carry, data):
        arrays, average, state = carry
        gradient = eqx.filter_grad(loss)(eqx.combine(arrays, static), *data)
        updates, state = optimiser.update(gradient, state, arrays)
        arrays = eqx.apply_updates(arrays, updates)
        average = optax.incremental_update(arrays, average, 1.0 - AVERAGING)
        return (arrays, average, state), None

    @jax.jit
    def epoch(carry, z: jax.Array, target: jax.Array):
        return jax.lax.scan(update, carry, (z, target))[0]

    for _ in range(EPOCHS):
        rows = rng.permutation(len(x))[: per_epoch * batch].reshape(per_epoch, batch)
        z = x[rows] + JITTER * rng.standard_normal(x[rows].shape)
        carry = epoch(carry, jnp.asarray(z), jnp.asarray(y[rows]))
    return _arrays(eqx.combine(carry[1], static))


def _arrays(network: Network) -> dict[str, NDArray[np.float32]]:
    """Return the weights by the names of the NumPy network; both order the gates i f g o."""
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
