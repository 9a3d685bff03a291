"""Smooth random motions of six joints about zero."""

import numpy as np


def walk(seed, n):
    """Return commands (n, 6) of arms whose joints gather speed and lose it again, rad and m."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0, [0.003, 0.005, 0.0007, 0.03, 0.02, 0.025], (n, 6))
    return np.clip(np.cumsum(np.cumsum(steps, axis=0) * 0.3, axis=0), -1, 1)
