import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.calibration.play import play_operator
from trocar.errors import TrocarError

seeds = st.integers(0, 2**32 - 1)


def walk(seed, n=60, width=1):
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.1, (n, width)), axis=0).squeeze()


@given(seed=seeds, r=st.floats(0.0, 0.5))
def test_slack_stays_within_the_radius(seed, r):
    u = walk(seed)
    assert np.all(np.abs(u - play_operator(u, r)) <= r + 1e-12)


@given(seed=seeds)
def test_play_is_rate_independent(seed):
    u = walk(seed)
    dense = np.interp(np.arange(0, len(u) - 0.5, 0.25), np.arange(len(u)), u)
    assert_allclose(play_operator(dense, 0.13)[::4], play_operator(u, 0.13), atol=1e-12)


@given(seed=seeds)
def test_one_radius_and_many_agree(seed):
    u, radii = walk(seed, width=3), np.array([0.02, 0.1, 0.4])
    many = play_operator(u[:, :, None], radii)
    for i in range(3):
        for k, r in enumerate(radii):
            assert_allclose(many[:, i, k], play_operator(u[:, i], r), atol=1e-14)


def test_a_loop_opens_by_two_radii():
    u = np.concatenate([np.linspace(-1, 1, 50), np.linspace(1, -1, 50)])
    p = play_operator(u, 0.2)
    assert_allclose(np.interp(0, u[50:][::-1], p[50:][::-1]) - np.interp(0, u[:50], p[:50]), 0.4, atol=1e-12)


def test_carries_its_state_over_calls():
    u = walk(1)
    head = play_operator(u[:20], 0.1)
    tail = play_operator(u[20:], 0.1, start=head[-1])
    assert_allclose(np.concatenate([head, tail]), play_operator(u, 0.1))


@pytest.mark.parametrize(("u", "r"), [([0.0, np.nan], 0.1), ([0.0, 1.0], -0.1)])
def test_bad_input_is_one_sentence(u, r):
    with pytest.raises(TrocarError):
        play_operator(u, r)
