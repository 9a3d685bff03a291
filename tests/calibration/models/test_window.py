import numpy as np
from numpy.testing import assert_array_equal

from trocar.calibration.models.linear import resting_window, windows

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
