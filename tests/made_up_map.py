"""Maps with dexterities chosen by the test."""

from dataclasses import replace

import numpy as np

from trocar.arms import PSM_CLASSIC
from trocar.tasks.suture.planning import DexterityMap, Reward, SutureJoints, SutureSetup


def made_up_map(values, feasible=None, feasible_first=True):
    """Return a map with these values (2, n); where ``feasible`` (2, n) is false, the insertion exceeds its range."""
    values = np.asarray(values, dtype=float)
    n = values.shape[1]
    q = np.broadcast_to(PSM_CLASSIC.middle, (2, n, 1, 6)).copy()
    feasible = np.ones((2, n), dtype=bool) if feasible is None else np.asarray(feasible)
    q[~feasible, 0, 2] = PSM_CLASSIC.upper[2] + 0.01
    joints = SutureJoints(SutureSetup(), 2 * np.pi / n * np.arange(n), q, np.array([True]), *np.ones((3, 2, n)))
    reward = replace(Reward(), feasible_first=feasible_first)
    choice = np.argmax(values - 1e9 * ~feasible if feasible_first else values, axis=0)
    by_arm = np.zeros((2, n))
    return DexterityMap(joints.setup, reward, joints, values, by_arm, by_arm[0], values, choice, (1.0, 1.0))
