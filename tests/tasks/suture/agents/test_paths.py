"""Motions along the dense joint paths of a suture."""

import numpy as np
import pytest

from trocar.tasks.suture.agents.paths import along, run_up


def test_the_start_of_a_way_is_come_to_along_it():
    q = np.linspace(np.zeros(6), np.ones(6), 11)
    np.testing.assert_allclose(run_up(q, 5e-3, 1e-3), [-0.2, -0.2, -0.2, 0.0, 0.0, 0.0])  # the wrist is there already
    np.testing.assert_allclose(run_up(q, 5e-3, 0.3e-3)[:3], -0.06)  # between two waypoints, too
    np.testing.assert_allclose(run_up(q[:2], 0.5e-3, 1e-3)[:3], -0.2)


def test_a_motion_along_a_path_keeps_to_it_and_rests_at_both_ends():
    share = np.linspace(0.0, 1.0, 30)[:, None]
    path = np.hstack([np.sin(share * (k + 1)) for k in range(6)])
    motion = along(path, 2.0)
    assert motion.duration_s == pytest.approx(2.0)
    np.testing.assert_allclose(motion([0.0, 2.0]), path[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(motion([0.0, 2.0], 1), 0.0, atol=1e-12)
    q = motion(np.linspace(0.0, 2.0, 200))
    fine = np.hstack([np.sin(np.linspace(0, 1, 60_000)[:, None] * (k + 1)) for k in range(6)])
    assert max(np.abs(fine - row).max(axis=1).min() for row in q) < 1e-4
