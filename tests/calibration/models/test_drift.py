"""The whitening of drifting measurements: against its dense definition, and for its purpose."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trocar.calibration.models.play_map import DRIFT_ROWS, DriftWhitener, drift_ratio, fit_linear

RATIO = 0.3


def _covariance(rows):
    return np.eye(len(rows)) + RATIO * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)


@given(steps=st.lists(st.integers(1, 90), min_size=1, max_size=30), seed=st.integers(0, 2**32 - 1))
def test_whitening_is_the_inverse_cholesky_factor_also_over_gaps(steps, seed):
    rows = np.cumsum(steps)
    a = np.random.default_rng(seed).normal(size=(len(rows), 3))
    white = np.linalg.solve(np.linalg.cholesky(_covariance(rows)), a)
    np.testing.assert_allclose(DriftWhitener.of(rows, RATIO)(a), white, atol=1e-12)


def test_a_ridge_without_a_whitener_keeps_its_constant_free():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2)) * [1.0, 3.0] + 5.0
    linear, constant = fit_linear(x, x @ np.array([[2.0], [-1.0]]) + 7.0, 1e-9)
    np.testing.assert_allclose(linear, [[2.0, -1.0]], atol=1e-8)
    np.testing.assert_allclose(constant, 7.0, atol=1e-7)


def test_whitening_finds_the_slope_better_when_the_errors_drift():
    rng = np.random.default_rng(1)
    rows = np.arange(300)
    factor = np.linalg.cholesky(_covariance(rows))
    x = np.sin(rows / 40.0)[:, None]
    plain, white = [], []
    for _ in range(200):
        y = x + factor @ rng.normal(size=(len(rows), 1))
        plain.append(fit_linear(x, y, 1e-6)[0].item() - 1.0)
        white.append(fit_linear(x, y, 1e-6, DriftWhitener.of(rows, RATIO))[0].item() - 1.0)
    assert np.std(white) < 0.99 * np.std(plain)
    assert abs(np.mean(white)) < 3.0 * np.std(white) / np.sqrt(len(white))


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
