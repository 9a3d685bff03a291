import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, MOTION_LIMITS, fk
from trocar.errors import TrocarError
from trocar.motion import duration_bound_s, limit_use, rest_to_rest, straight

LIMITS = MOTION_LIMITS["paper"]
PSM = ARMS["psm-classic"]
OVER_THE_BOARD = np.array([0.90, 0.08, 0.185, 0.27, 0.25, -0.88])


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(1e-6, 1))
def test_rest_to_rest_is_straight_within_limits_and_shortest(seed, share):
    rng = np.random.default_rng(seed)
    start, end = PSM.middle + rng.uniform(-0.45, 0.45, (2, 6)) * (PSM.upper - PSM.lower)
    end = start + share * (end - start)
    move = rest_to_rest(start, end, LIMITS)
    use = limit_use(PSM, move, LIMITS)
    assert use.kept
    assert max(use.velocity_ratio, use.acceleration_ratio) == pytest.approx(1, abs=1e-9)
    assert move.duration_s == pytest.approx(duration_bound_s([start, end], LIMITS), rel=1e-9)
    np.testing.assert_allclose(move(0.0), start, atol=1e-12)
    np.testing.assert_allclose(move(move.duration_s), end, atol=1e-12)
    np.testing.assert_allclose(move(np.nextafter(move.duration_s, 0), 1), 0, atol=1e-9)


def test_a_move_to_where_it_is_holds():
    for move in (
        rest_to_rest(PSM.middle, PSM.middle, LIMITS),
        straight(PSM, OVER_THE_BOARD, [0, 0, 0], LIMITS),
    ):
        assert move.duration_s == pytest.approx(0.01)
        assert not move(np.linspace(0, 0.01, 5), 1).any()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), length_m=st.floats(1e-4, 0.03))
def test_straight_is_straight_for_the_tip_between_knots(seed, length_m):
    direction = np.random.default_rng(seed).normal(size=3)
    direction /= np.linalg.norm(direction)
    move = straight(PSM, OVER_THE_BOARD, length_m * direction, LIMITS)
    use = limit_use(PSM, move, LIMITS)
    assert use.kept
    assert max(use.velocity_ratio, use.acceleration_ratio) > 0.999
    T = fk(PSM, move(np.linspace(0, move.duration_s, 3001)))
    off = T.translation_m - T.translation_m[0]
    across = off - np.outer(off @ direction, direction)
    assert np.abs(across).max() < 1e-6
    np.testing.assert_allclose(off[-1], length_m * direction, atol=1e-9)
    assert np.abs((T.rotation @ T[0].rotation.inverse()).log()).max() < 1e-5


def test_straight_refuses_what_it_cannot_reach():
    with pytest.raises(TrocarError, match="out of its range"):
        straight(PSM, OVER_THE_BOARD, [0, 0, -0.15], LIMITS)
    with pytest.raises(TrocarError, match="three finite numbers"):
        straight(PSM, OVER_THE_BOARD, [0, 0, np.nan], LIMITS)
    with pytest.raises(TrocarError, match="finite joint values"):
        rest_to_rest(PSM.middle, [0, 0, np.nan, 0, 0, 0], LIMITS)
