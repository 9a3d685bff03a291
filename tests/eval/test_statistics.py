"""Rates and their intervals."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import betabinom

from trocar.errors import TrocarError
from trocar.eval.statistics import session_interval, wilson_interval


@pytest.mark.parametrize(
    ("succeeded", "attempted", "low", "high"),
    [(120, 120, 0.9690, 1.0), (26, 75, 0.2488, 0.4595), (0, 40, 0.0, 0.0876), (40, 40, 0.9124, 1.0)],
)
def test_wilsons_interval_is_the_published_one(succeeded, attempted, low, high):
    assert wilson_interval(succeeded, attempted) == pytest.approx((low, high), abs=1e-4)


def test_of_nothing_everything_is_possible():
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert session_interval([], []) == (0.0, 1.0)
    assert session_interval([0, 0], [0, 0]) == (0.0, 1.0)


def test_more_successes_than_attempts_are_refused():
    with pytest.raises(TrocarError, match="3 successes of 2"):
        wilson_interval(3, 2)
    with pytest.raises(TrocarError, match="successes of"):
        session_interval([3], [2])


def test_the_interval_counts_sessions_and_not_attempts():
    """Ten times as many attempts in the same sessions say hardly more; ten times as many sessions do."""
    few = session_interval([12] * 10, [12] * 10)
    attempts = session_interval([120] * 10, [120] * 10)
    sessions = session_interval([12] * 100, [12] * 100)
    assert few[1] == attempts[1] == sessions[1] == 1.0
    assert attempts[0] - few[0] < 0.03
    assert sessions[0] > 0.95
    assert few[0] < wilson_interval(120, 120)[0]


@pytest.mark.parametrize("succeeded", [(3, 9, 7, 12), (6, 6)])
def test_the_interval_is_that_of_the_beta_binomial_whatever_the_sessions_share(succeeded):
    """Summed over a coarse grid of rates and correlations, with the prior of Jeffreys times one minus the latter."""
    mean, icc = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(60) + 0.5) / 60, indexing="ij")
    a, b = mean * (1 / icc - 1), (1 - mean) * (1 / icc - 1)
    likelihood = np.prod([betabinom.pmf(y, 12, a, b) for y in succeeded], axis=0)
    weights = (likelihood * (1 - icc) / np.sqrt(mean * (1 - mean))).sum(axis=1)
    expected = np.interp([0.025, 0.975], np.cumsum(weights) / weights.sum(), (np.arange(400) + 1) / 400)
    assert session_interval(succeeded, [12] * len(succeeded)) == pytest.approx(expected, abs=1e-4)


def test_one_session_says_little():
    low, high = session_interval([12], [12])
    assert low < 0.5 and high == 1.0


def test_sessions_that_differ_widen_the_interval():
    alike = session_interval([6] * 10, [12] * 10)
    differ = session_interval([0] * 5 + [12] * 5, [12] * 10)
    assert differ[1] - differ[0] > 1.5 * (alike[1] - alike[0])
    for low, high in (alike, differ):
        assert low < 0.5 < high


@pytest.mark.parametrize(("mean", "icc", "sessions"), [(0.97, 0.05, 10), (0.9, 0.6, 4), (0.25, 0.02, 4)])
def test_it_holds_the_truth_about_as_often_as_it_says(mean, icc, sessions):
    """Sessions drawn from a beta distribution: at least 88 % of 95 % intervals hold the mean (60 draws)."""
    rng, interval_of = np.random.default_rng(7), cache(lambda *succeeded: session_interval(succeeded, [12] * sessions))
    precision = 1 / icc - 1
    held = 0
    for _ in range(60):
        rates = rng.beta(mean * precision, (1 - mean) * precision, sessions)
        low, high = interval_of(*sorted(rng.binomial(12, rates).tolist()))
        held += low <= mean <= high
    assert held >= 53
