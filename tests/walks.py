"""Smooth random motions of six joints about zero."""

import numpy as np


def walk(seed, n):
    """Return random joint commands (n, 6), rad and m, that speed up and slow down."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0, [0.003, 0.005, 0.0007, 0.03, 0.02, 0.025], (n, 6))
    return np.clip(np.cumsum(np.cumsum(steps, axis=0) * 0.3, axis=0), -1, 1)
