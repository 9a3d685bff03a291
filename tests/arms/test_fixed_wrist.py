import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, PSM_CLASSIC, fk, ik_with_fixed_wrist, wrist_depth_m
from trocar.errors import OutOfReach, TrocarError

arms = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)


@arms
@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_tip_or_what_it_holds_comes_there_and_the_wrist_rests(arm, seed):
    rng = np.random.default_rng(seed)
    q = arm.middle + 0.3 * (arm.upper - arm.lower) * rng.uniform(-1, 1, 6)
    asked = q + np.concatenate([rng.uniform(-1, 1, 3) * [0.1, 0.1, 0.02], np.zeros(3)])
    assume(min(wrist_depth_m(arm, q), wrist_depth_m(arm, asked)) > arm.safe_depth_m)
    held_m = rng.choice([0.0, 0.02]) * rng.uniform(-1, 1, 3)
    found = ik_with_fixed_wrist(arm, q, fk(arm, asked).apply(held_m), held_m)
    np.testing.assert_array_equal(found[3:], q[3:])
    np.testing.assert_allclose(found, asked, rtol=0, atol=1e-6)
    if not held_m.any():
        tip_alone = ik_with_fixed_wrist(arm, q, fk(arm, asked).translation_m)
        np.testing.assert_allclose(tip_alone, found, rtol=0, atol=1e-9)


def test_a_place_beyond_a_joints_range_is_refused_by_the_joints_name():
    q = PSM_CLASSIC.middle.copy()
    q[2] = PSM_CLASSIC.upper[2] - 1e-3
    deeper_m = fk(PSM_CLASSIC, q).translation_m * 1.05
    with pytest.raises(OutOfReach, match="insertion"):
        ik_with_fixed_wrist(PSM_CLASSIC, q, deeper_m)


@pytest.mark.parametrize("place_m", [(np.nan, 0.0, 0.0), (0.1, 0.2), "there"])
def test_what_is_no_place_is_refused(place_m):
    with pytest.raises(TrocarError, match="a place of arm 'psm-classic' must"):
        ik_with_fixed_wrist(PSM_CLASSIC, PSM_CLASSIC.middle, place_m)
    with pytest.raises(TrocarError, match="a place of arm 'psm-classic' must"):
        ik_with_fixed_wrist(PSM_CLASSIC, PSM_CLASSIC.middle, (0.0, 0.0, -0.1), place_m)
