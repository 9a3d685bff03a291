"""A prior over instruments that is drawn at random, not learned, and recordings that match it."""

import numpy as np

from trocar.calibration.fleet.prior import FEATURES, FleetPrior, LoopFit, LoopShape
from trocar.calibration.plant import play_slacks
from trocar.calibration.recording import Recording
from walks import walk

SHAPE = LoopShape(np.array([0.05, 0.08, 0.11]), 0.1, 0.15)


def fleet(seed=0, count=4):
    """Return a prior over instruments whose hysteresis loops are drawn at random."""
    rng = np.random.default_rng(seed)
    fits = [
        LoopFit(
            f"arm{k}_{seed}",
            SHAPE.theta + rng.normal(0, [0.3, 0.5, 0.2, 0.05, 0.1]),
            rng.normal(0, 0.1, (3, FEATURES)) + 0.1,
            rng.normal(0, 0.002, (3, 7)),
            rng.uniform(0.5, 2.0, 6) * np.array([1e-6, 2e-6, 1e-8, 1e-4, 2e-4, 3e-4]),
        )
        for k in range(count)
    ]
    return FleetPrior.of(fits)


def slack_recording(prior, rows, start, seed=0, noise=0.0):
    """Return a recording whose loops have a prior's mean weights, from slacks ``start`` (3,), shares of the radii."""
    q, rng = 0.5 * walk(seed, rows), np.random.default_rng(seed)
    banks = SHAPE.banks
    slacks = play_slacks(q, SHAPE.a, SHAPE.b, banks, np.asarray(start)[:, None] * banks)
    features = np.column_stack([np.ones(rows), q[:, 3:], slacks.reshape(rows, -1)])
    q_phy = q.copy()
    q_phy[:, 3:] += features @ prior.weights.T + noise * rng.normal(size=(rows, 3))
    q_phy[:, :3] += noise * rng.normal(size=(rows, 3))
    return Recording(q, q_phy, rng.random(rows) > 0.1, np.arange(float(rows)))
