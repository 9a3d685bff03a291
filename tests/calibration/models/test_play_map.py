"""Regressions whose errors drift, and the map that they fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.calibration.models.play_map import (
    CENTRES,
    DRIFT_ROWS,
    DriftWhitener,
    PlayMap,
    _fits,
    drift_ratio,
    fit_linear,
    fit_map,
)
from trocar.errors import TrocarError

RATIO = 0.3


def _covariance(rows, ratio=RATIO):
    return np.eye(len(rows)) + ratio * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)


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
        covariance = _covariance(rows, ratio)
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


def bumpy(seed=0, features=9):
    rng = np.random.default_rng(seed)
    return PlayMap(
        linear=rng.normal(size=(3, features)),
        inputs=np.array([0, 2, 5]),
        mean=rng.normal(size=3),
        scale=rng.uniform(0.5, 2.0, 3),
        centres=rng.normal(size=(4, 3)),
        bumps=rng.normal(size=(3, 4)),
    )


def test_a_bump_is_a_gaussian_about_its_centre():
    one = PlayMap(np.array([[1.0, 10.0]] * 3), np.array([1]), np.array([2.0]), np.array([0.5]), *np.ones((2, 1, 1)))
    one = PlayMap(one.linear, one.inputs, one.mean, one.scale, one.centres, np.array([[1.0], [2.0], [-3.0]]))
    for x, height in ((2.5, 1.0), (3.0, np.exp(-0.5)), (1.5, np.exp(-2.0)), (9.0, 0.0)):
        assert_allclose(one(np.array([7.0, x])), 7.0 + 10.0 * x + height * np.array([1.0, 2.0, -3.0]), atol=1e-12)


@pytest.mark.parametrize("bumps", [True, False])
def test_values_and_slopes_agree_with_small_steps(bumps):
    rng, fitted = np.random.default_rng(1), bumpy()
    if not bumps:
        fitted = PlayMap(*(getattr(fitted, key) for key in ("linear", "inputs", "mean", "scale")), *np.zeros((2, 0, 3)))
    x = rng.normal(size=(5, 9))
    values, gradients = fitted.slopes(x)
    assert gradients.shape == (5, 3, 9)
    assert_allclose(values, fitted(x), atol=1e-12)
    for row, value, gradient in zip(x, values, gradients, strict=True):
        one, slope = fitted.linearize(row)
        assert_allclose(one, value, atol=1e-12)
        assert_allclose(slope, gradient, atol=1e-12)
        steps = [(fitted(row + 1e-6 * d) - fitted(row - 1e-6 * d)) / 2e-6 for d in np.eye(9)]
        assert_allclose(gradient, np.transpose(steps), atol=1e-7)
    assert_allclose(bumpy().linear, bumpy().linear)
    assert np.array_equal(fitted.linear, bumpy().linear)  # a gradient is no view of the weights


def test_a_regression_is_a_ridge_on_standardised_features_with_a_free_constant():
    rng = np.random.default_rng(2)
    x, y = rng.normal(5.0, [0.1, 3.0], (40, 2)), rng.normal(7.0, 1.0, (40, 3))
    z = (x - x.mean(axis=0)) / x.std(axis=0)
    for penalty in (0.5, 20.0):
        linear, constant = fit_linear(x, y, penalty)
        more = np.vstack([z, np.sqrt(penalty) * np.eye(2)])
        weights = np.linalg.lstsq(more, np.vstack([y - y.mean(axis=0), np.zeros((2, 3))]), rcond=None)[0]
        assert_allclose(x @ linear.T + constant, y.mean(axis=0) + z @ weights, atol=1e-9)


def test_a_regression_with_a_whitener_is_generalised_least_squares():
    rng, rows = np.random.default_rng(3), np.array([0, 1, 2, 5, 6, 9, 30, 31, 32, 40])
    x, y = rng.normal(1.0, 2.0, (10, 2)), rng.normal(size=(10, 1))
    alike = _covariance(rows, 0.7)
    features = np.column_stack([np.ones(10), (x - x.mean(axis=0)) / x.std(axis=0)])
    normal = features.T @ np.linalg.solve(alike, features) + np.diag([0.0, 2.0, 2.0])
    weights = np.linalg.solve(normal, features.T @ np.linalg.solve(alike, y))
    linear, constant = fit_linear(x, y, 2.0, DriftWhitener.of(rows, 0.7))
    assert_allclose(x @ linear.T + constant, features @ weights, atol=1e-9)


@pytest.mark.parametrize(("moves_by", "weighs"), [(0.0, False), (1e-6, True)])
def test_a_feature_that_is_constant_has_no_weight(moves_by, weighs):
    x = np.random.default_rng(4).normal(size=(30, 3))
    x[:, 1] = 4.0 + moves_by * x[:, 1]
    linear, constant = fit_linear(x, x[:, :1] + 5.0 * (x[:, 1:2] - 4.0) / max(moves_by, 1.0), 1e-3)
    assert np.isfinite(constant).all() and linear[:, 1].any() == weighs


def made(seed, n=150, radii=2, bend=0.0, noise=0.0):
    """Return features (n, 3 + 3 radii) and errors (n, 3) of a map that is linear, or bends in q4 and in a slack."""
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, 0.3, (n, 3 + 3 * radii))
    linear = np.random.default_rng(99).normal(0.0, 0.5, (3, x.shape[1]))
    bent = bend * np.column_stack([np.cos(4 * x[:, 0]), np.sin(3 * x[:, 3]), x[:, 0] * x[:, 3]])
    return x, x @ linear.T + bent + [0.1, -0.2, 0.3] + noise * rng.normal(size=(n, 3)), linear


def test_what_is_linear_gets_no_bumps():
    x, y, linear = made(3, noise=0.1)
    fitted, constant = fit_map(x, y, np.arange(len(x)))
    assert fitted.centres.shape == (0, 6) and fitted.bumps.shape == (3, 0)
    assert_allclose(fitted.linear, linear, atol=0.15)
    assert_allclose(constant, [0.1, -0.2, 0.3], atol=0.05)


def test_what_bends_is_followed_by_bumps():
    x, y, _ = made(1, bend=0.3, noise=0.005)
    fresh, true, _ = made(2, bend=0.3)
    fitted, constant = fit_map(x, y, np.arange(len(x)))
    error = fitted(fresh) + constant - true
    straight, offset = fit_linear(x, y, 3.0)
    assert len(fitted.centres) == len(x)
    assert np.sqrt(np.mean(error**2)) < 0.6 * np.sqrt(np.mean((fresh @ straight.T + offset - true) ** 2))
    assert_allclose(fitted.inputs, [0, 1, 2, 3, 5, 7])  # of each joint's slacks the first
    assert_allclose(fitted.mean, x[:, fitted.inputs].mean(axis=0))
    assert_allclose(fitted.scale, 3.0 * x[:, fitted.inputs].std(axis=0))


def test_each_joint_gets_what_predicts_blocks_of_time_best_that_were_left_out():
    """Beside the same search spelled out."""
    x, y, _ = made(5, n=60, bend=0.2, noise=0.08)
    y[:, 2] = made(6, n=60, noise=0.5)[1][:, 2]
    rows = np.arange(60)
    candidates = [(penalty, ratio) for penalty in (3.0, 30.0) for ratio in (0.1, 1.0, np.inf)]
    best = np.full(3, np.inf)
    chosen = np.zeros((60, 3))
    whole = _fits(x, y, rows, 0.0, candidates)
    for k, candidate in enumerate(candidates):
        score = np.zeros(3)
        for block in np.split(rows, 5):
            train = np.delete(rows, block)
            ((fitted, constant),) = _fits(x[train], y[train], train, 0.0, [candidate])
            score += np.sum((fitted(x[block]) + constant - y[block]) ** 2, axis=0)
        better = score < best
        chosen[:, better] = (whole[k][0](x) + whole[k][1])[:, better]
        best = np.minimum(best, score)
    fitted, constant = fit_map(x, y, rows)
    assert_allclose(fitted(x) + constant, chosen, atol=1e-9)


def test_bumps_are_the_gaussian_process_of_what_the_linear_part_leaves():
    """As many centres as samples: kernel regression, by the textbook."""
    x, y, _ = made(7, n=40, bend=0.3)
    (linear_only, constant), (fitted, same) = _fits(x, y, np.arange(40), 0.0, [(3.0, np.inf), (3.0, 0.5)])
    assert not linear_only.bumps.any()
    assert_allclose(constant, same)
    z = (x[:, fitted.inputs] - x[:, fitted.inputs].mean(axis=0)) / (3.0 * x[:, fitted.inputs].std(axis=0))
    kernel = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2))
    left = y - linear_only(x) - constant
    assert_allclose(fitted(x) - linear_only(x), kernel @ np.linalg.solve(kernel + 0.5 * np.eye(40), left), atol=1e-4)


def test_errors_that_drift_are_not_taken_for_a_map():
    rng, rows = np.random.default_rng(8), np.arange(300)
    drift = np.linalg.cholesky(_covariance(rows))
    x, y, _ = made(9, n=300)
    y += 0.5 * drift @ rng.normal(size=(300, 3))
    fitted, _ = fit_map(x, y, rows)
    candidates = [(penalty, np.inf) for penalty in (3.0, 30.0)]
    nearest = [
        np.min([np.abs(one.linear - fitted.linear).max(axis=1) for one, _ in _fits(x, y, rows, ratio, candidates)], 0)
        for ratio in (0.3, 0.0)
    ]
    assert (nearest[0] < 1e-9).all() and (nearest[1] > 1e-4).all()


def test_of_many_samples_some_evenly_spaced_ones_are_centres():
    n = CENTRES + 60
    x, y, _ = made(10, n=n)
    ((fitted, _),) = _fits(x, y, np.arange(n), 0.0, [(3.0, 1.0)])
    z = (x[:, fitted.inputs] - fitted.mean) / fitted.scale
    places = [int(np.abs(z - centre).sum(axis=1).argmin()) for centre in fitted.centres]
    assert len(places) == CENTRES and places[0] == 0 and places[-1] == n - 1
    assert set(np.diff(places)) == {1, 2}
    assert_allclose(fitted.centres, z[places])


def test_arrays_that_no_map_has_are_refused():
    fitted = bumpy(features=6)
    arrays = fitted.arrays()
    again = PlayMap.from_arrays(arrays, 1)
    for key in PlayMap.__dataclass_fields__:
        assert np.array_equal(getattr(again, key), getattr(fitted, key))
    with pytest.raises(TrocarError, match="'map_linear' has shape"):
        PlayMap.from_arrays(arrays, 2)
    for key, wrong in (
        *(("map_inputs", [0, 2, 6]), ("map_inputs", [0, -1, 5]), ("map_inputs", [0.0, 2.0, 5.0])),
        *(("map_scale", [1.0, 0.0, 1.0]), ("map_scale", [1.0, 1.0, -1.0])),
    ):
        with pytest.raises(TrocarError, match="'map_inputs' or 'map_scale' are not valid"):
            PlayMap.from_arrays(arrays | {key: np.array(wrong)}, 1)
    assert PlayMap.from_arrays(arrays | {"map_inputs": np.array([0, 1, 5], np.uint8)}, 1).inputs[2] == 5
    for key, wrong in (
        *(("map_mean", np.zeros(2)), ("map_centres", np.zeros((4, 2))), ("map_centres", np.zeros((3, 3)))),
        *(("map_bumps", np.zeros((3, 5))), ("map_bumps", np.zeros((2, 4))), ("map_linear", np.zeros((2, 6)))),
    ):
        with pytest.raises(TrocarError, match="has shape"):
            PlayMap.from_arrays(arrays | {key: wrong}, 1)
