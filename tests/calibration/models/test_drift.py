"""The whitening of drifting measurements: against its dense definition, and for its purpose."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trocar.calibration.models.play_map import DRIFT_ROWS, DriftWhitener, drift_ratio

RATIO = 0.3


def _covariance(rows):
    return np.eye(len(rows)) + RATIO * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)


@given(steps=st.lists(st.integers(1, 90), min_size=1, max_size=30), seed=st.integers(0, 2**32 - 1))
def test_whitening_is_the_inverse_cholesky_factor_also_over_gaps(steps, seed):
    rows = np.cumsum(steps)
    a = np.random.default_rng(seed).normal(size=(len(rows), 3))
    white = np.linalg.solve(np.linalg.cholesky(_covariance(rows)), a)
    np.testing.assert_allclose(DriftWhitener.of(rows, RATIO)(a), white, atol=1e-12)


def test_drift_is_assumed_where_residuals_drift_and_only_there():
    rng = np.random.default_rng(2)
    rows = np.arange(1000)
    noise = rng.normal(size=(len(rows), 3))
    assert drift_ratio(rows, noise) == 0.0
    assert drift_ratio(rows, np.linalg.cholesky(_covariance(rows)) @ noise) == RATIO


def test_the_likelihood_is_that_of_a_normal_distribution_of_the_likeliest_scale():
    """Up to a constant: what one ratio of drift says more than another, in each column by itself."""
    rows = np.cumsum([1, 1, 5, 2, 30, 1, 1, 3])
    residuals = np.random.default_rng(3).normal(size=(8, 2)) * [0.1, 7.0]

    def dense(ratio):
        covariance = np.eye(8) + ratio * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)
        scales = np.sum(residuals * np.linalg.solve(covariance, residuals), axis=0) / 8
        return -0.5 * (8 * np.log(scales).sum() + 2 * np.linalg.slogdet(covariance)[1])

    found = [DriftWhitener.of(rows, ratio).log_likelihood(residuals) for ratio in (0.0, 0.3, 2.0)]
    np.testing.assert_allclose(np.diff(found), np.diff([dense(ratio) for ratio in (0.0, 0.3, 2.0)]), rtol=1e-6)


def test_residuals_of_zero_have_a_likelihood():
    assert np.isfinite(DriftWhitener.of(np.arange(5), 0.3).log_likelihood(np.zeros((5, 3))))


def test_a_drift_is_forgotten_after_some_twenty_rows():
    """Neighbours share their error; rows a hundred apart do not, and a row by itself is only scaled."""
    one = DriftWhitener.of(np.array([7]), 0.3)(np.ones((1, 1))).item()
    np.testing.assert_allclose(one, 1 / np.sqrt(1.3))
    near, far = (DriftWhitener.of(np.array([0, gap]), 10.0)(np.array([[1.0], [0.0]]))[1].item() for gap in (1, 200))
    assert near < -0.3 and abs(far) < 1e-3
