import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.calibration.plant import play_operator
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


def test_by_hand():
    """Up by one, back by less than the width, and down through it."""
    u = [0.0, 1.0, 0.9, 0.5, 0.4, -1.0, -0.7]
    assert_allclose(play_operator(u, 0.25), [0.0, 0.75, 0.75, 0.75, 0.65, -0.75, -0.75])
    assert_allclose(play_operator(u, 0.0), u)
    assert_allclose(play_operator(u, 0.25, start=0.2), [0.2, 0.75, 0.75, 0.75, 0.65, -0.75, -0.75])
    assert_allclose(play_operator(u, 0.25, start=-3.0)[0], -0.25)
    assert_allclose(play_operator(u, 0.25, start=3.0)[0], 0.25)


@pytest.mark.parametrize("columns", [1, 2, 4, 5, 27])
def test_few_operators_and_many_are_computed_alike(columns):
    """In one go or one after the other, from any start; and of a batch of inputs with a radius for each."""
    rng = np.random.default_rng(columns)
    u, radii = walk(columns, width=columns).reshape(60, columns), rng.uniform(0.0, 0.3, columns)
    start = u[0] + rng.uniform(-0.5, 0.5, columns)
    for begin in (None, start):
        found = play_operator(u, radii, begin)
        assert found.shape == u.shape
        for k in range(columns):
            one = play_operator(u[:, k], radii[k], None if begin is None else begin[k])
            assert_allclose(found[:, k], one, atol=1e-15)


def test_one_input_drives_operators_of_many_radii():
    u, radii = walk(3)[:, None, None], np.array([[0.1, 0.2], [0.3, 0.4]])
    found = play_operator(u, radii)
    assert found.shape == (60, 2, 2)
    for index in np.ndindex(2, 2):
        assert_allclose(found[(slice(None), *index)], play_operator(u[:, 0, 0], radii[index]))


def test_no_input_is_no_output():
    assert play_operator(np.empty(0), 0.1).shape == (0,)
    assert play_operator(np.empty((0, 3)), 0.1).shape == (0, 3)
    assert play_operator(np.empty((0, 30)), np.full(30, 0.1)).shape == (0, 30)
    assert play_operator(np.empty((5, 0)), 0.1).shape == (5, 0)


@pytest.mark.parametrize(
    ("u", "r"), [([0.0, np.nan], 0.1), ([0.0, np.inf], 0.1), ([0.0, 1.0], -0.1), ([0.0, 1.0], np.nan)]
)
def test_bad_input_is_one_sentence(u, r):
    with pytest.raises(TrocarError):
        play_operator(u, r)
