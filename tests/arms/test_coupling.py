import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import PSM_CLASSIC, RAVEN2_LEFT, actuators_from_joints, joints_from_actuators
from trocar.errors import TrocarError


@given(seed=st.integers(0, 2**32 - 1))
def test_joints_and_actuators_are_inverse(seed):
    joints = np.random.default_rng(seed).uniform(-2, 2, (3, 5, 4))
    back = joints_from_actuators(PSM_CLASSIC, actuators_from_joints(PSM_CLASSIC, joints))
    np.testing.assert_allclose(back, joints, atol=1e-14)


def test_single_disks_move_the_joints_they_are_wound_to():
    roll, pitch, third, fourth = joints_from_actuators(PSM_CLASSIC, np.eye(4))
    np.testing.assert_array_equal(roll, [-1.5632, 0, 0, 0])
    np.testing.assert_array_equal(pitch, [0, 1.0186, -0.8306, 0])  # the wrist pitch drags the jaws' cables
    np.testing.assert_array_equal(third, [0, 0, 0.6089, -1.2177])
    np.testing.assert_array_equal(fourth, [0, 0, 0.6089, 1.2177])


def test_bad_angles_and_unknown_couplings_are_refused():
    with pytest.raises(TrocarError, match="raven2-left"):
        joints_from_actuators(RAVEN2_LEFT, np.zeros(4))
    for bad, words in ((np.zeros(3), "must have shape"), (np.full(4, np.nan), "must be finite")):
        with pytest.raises(TrocarError, match=words):
            actuators_from_joints(PSM_CLASSIC, bad)
