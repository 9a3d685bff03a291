"""Comparisons between conditions over sessions, against cases worked out by hand."""

import numpy as np
import pytest
from scipy import stats

from trocar.errors import TrocarError
from trocar.eval.comparison import (
    Estimate,
    holm,
    rate_difference,
    ratio_estimate,
    ratio_of_ratios,
    session_difference,
    session_estimate,
)
from trocar.eval.statistics import session_posterior


def sessions(*values):
    return {session: [float(v) for v in np.atleast_1d(value)] for session, value in enumerate(values)}


def test_a_mean_counts_sessions_not_trials():
    few = session_estimate(sessions(1.0, 2.0, 6.0))
    many = session_estimate(sessions([1.0] * 50, [2.0] * 50, [6.0] * 50))
    assert (many.mean, many.low, many.high) == pytest.approx((few.mean, few.low, few.high))
    half = 4.302653 * np.std([1, 2, 6], ddof=1) / np.sqrt(3)  # Student's t of 2 degrees of freedom
    assert (few.low, few.high) == pytest.approx((3.0 - half, 3.0 + half), rel=1e-6)


def test_the_interval_of_what_is_never_negative_ends_at_zero():
    few, many = session_estimate(sessions(1.0, 2.0, 6.0)), session_estimate(sessions(3.0, 4.0, 5.0))
    assert few.low < 0 and few.not_negative() == Estimate(few.mean, 0.0, few.high)
    assert many.low > 0 and many.not_negative() == many


def test_a_single_session_has_no_interval():
    found = session_estimate(sessions([1.0, 2.0]))
    assert found.not_negative() == found
    assert (found.mean, found.low, found.high) == (1.5, None, None)
    with pytest.raises(TrocarError, match="no session"):
        session_estimate({})


def test_the_p_value_is_the_share_of_sign_patterns():
    """Of 2^4 patterns of +-1 +-2 +-3 +-4, only that of all minuses has a sum as low as -10; two reach -8."""
    assert session_difference(sessions(0, 0, 0, 0), sessions(1, 2, 3, 4), less=True).p == pytest.approx(1 / 16)
    assert session_difference(sessions(1, 0, 0, 0), sessions(0, 2, 3, 4), less=True).p == pytest.approx(2 / 16)
    assert session_difference(sessions(0, 0, 0, 0), sessions(1, 2, 3, 4), less=False).p == 1.0


def test_a_session_counts_with_the_mean_of_its_trials():
    found = session_difference(sessions([0, 0, 6], [1, 1, 7]), sessions([0, 3, 0], 0), less=False)
    assert found.mean == pytest.approx(np.mean([2 - 1, 3 - 0]))


def test_no_difference_is_never_significant():
    found = session_difference(sessions(1, 1, 1), sessions(1, 1, 1), less=True)
    assert (found.mean, found.low, found.high, found.p) == (0.0, 0.0, 0.0, 1.0)


def test_only_sessions_of_both_are_compared():
    found = session_difference({0: [1.0], 2: [5.0]}, {2: [2.0], 3: [9.0]}, less=False)
    assert (found.sessions, found.mean, found.low, found.p) == (1, 3.0, None, 0.5)
    nothing = session_difference({0: [1.0]}, {1: [1.0]}, less=True)
    assert (nothing.sessions, nothing.p) == (0, 1.0)


def test_trials_of_one_session_are_no_evidence_of_their_own():
    """A hundred trials in two sessions cannot be more significant than two sessions can: 1 of 4 patterns."""
    rng = np.random.default_rng(0)
    first = {s: list(rng.normal(0.0, 0.1, 50)) for s in range(2)}
    second = {s: list(rng.normal(5.0, 0.1, 50)) for s in range(2)}
    assert session_difference(first, second, less=True).p == pytest.approx(0.25)


def test_where_conditions_do_not_differ_few_are_called_different():
    """With effects of sessions far larger than the noise, 5 % of studies err, not more."""
    rng = np.random.default_rng(1)
    wrong = 0
    for _ in range(300):
        day = rng.normal(0.0, 3.0, 8)
        first, second = sessions(*(day + rng.normal(0, 1, 8))), sessions(*(day + rng.normal(0, 1, 8)))
        wrong += session_difference(first, second, less=True).p <= 0.05
    assert wrong <= stats.binom.ppf(0.999, 300, 0.05)
    assert wrong > 0


def test_rates_that_are_both_perfect_differ_by_what_the_sessions_leave_open():
    few, many = ([12] * 5, [12] * 5), ([12] * 60, [12] * 60)
    low, high = rate_difference(few, few)
    assert low == pytest.approx(-high, abs=1e-6) and high > 0.05
    assert rate_difference(many, many)[1] < 0.03


def test_rates_that_differ_are_told_apart():
    low, high = rate_difference(([12] * 8, [12] * 8), ([1, 2, 0, 3, 1, 2, 1, 2], [12] * 8))
    assert 0.6 < low < 0.88 < high < 1.0
    assert rate_difference(([12] * 8, [12] * 8), ([1, 2, 0, 3, 1, 2, 1, 2], [12] * 8), 0.5)[0] > low


@pytest.mark.parametrize("share", [0.95, 0.5])
def test_the_interval_of_a_difference_of_rates_holds_its_share_of_the_posterior(share):
    first, second = ([9, 11, 7], [12] * 3), ([3, 6, 2], [12] * 3)
    rng, drawn = np.random.default_rng(0), []
    for condition in (first, second):
        middles, weights = session_posterior(*condition)
        drawn.append(rng.choice(middles, 200_000, p=weights / weights.sum()))
    expected = np.quantile(drawn[0] - drawn[1], [(1 - share) / 2, (1 + share) / 2])
    assert rate_difference(first, second, share) == pytest.approx(expected, abs=4e-3)


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([]) == []


def test_a_ratio_of_sums_is_the_sessions_mean_where_denominators_agree():
    values = {k: [(x, 2.0)] for k, x in enumerate([10.0, 12.0, 17.0])}
    found = ratio_estimate(values)
    same = session_estimate({k: [pairs[0][0] / 2.0] for k, pairs in values.items()})
    assert (found.mean, found.low, found.high) == pytest.approx((same.mean, same.low, same.high))


def test_a_ratio_counts_sessions_in_which_nothing_was_reached():
    found = ratio_estimate({0: [(10.0, 5.0)], 1: [(10.0, 0.0)]})
    assert found.mean == 4.0
    assert ratio_estimate({0: [(10.0, 0.0)]}) is None
    assert ratio_estimate({0: [(10.0, -3.0)], 1: [(10.0, 2.0)]}) is None
    assert ratio_estimate({0: [(10.0, 5.0)]}).low is None


def test_the_interval_of_a_ratio_covers_it():
    """Of 300 studies of 10 sessions, 90 to 99 % have an interval that holds the true ratio."""
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(300):
        of = rng.integers(3, 7, 10)
        seconds = of * (8.0 + rng.standard_normal(10)) + rng.standard_normal(10)
        found = ratio_estimate({k: [(seconds[k], of[k])] for k in range(10)})
        held += found.low <= 8.0 <= found.high
    assert 0.90 < held / 300 < 0.99


def test_two_ratios_are_compared_in_the_sessions_that_both_have():
    slow = {k: [(20.0 + k, 2.0)] for k in range(6)} | {9: [(1e3, 1.0)]}
    fast = {k: [(10.0 + 0.5 * k, 2.0)] for k in range(6)}
    found = ratio_of_ratios(slow, fast)
    assert (found.mean, found.low, found.high) == pytest.approx((2.0, 2.0, 2.0))  # sessions are drawn in pairs
    noisy = ratio_of_ratios(slow, {k: [(10.0 + (-1) ** k, 2.0)] for k in range(6)})
    assert noisy.low < noisy.mean < noisy.high
    assert ratio_of_ratios(slow, {0: [(1.0, 0.0)]}) is None
    assert ratio_of_ratios(slow, {}) is None
    assert ratio_of_ratios({0: [(4.0, 2.0)]}, {0: [(1.0, 1.0)]}).low is None
    two = ratio_of_ratios({k: [(4.0 + k, 2.0)] for k in range(2)}, {k: [(1.0, 1.0)] for k in range(2)})
    assert (two.low, two.mean, two.high) == pytest.approx((2.0, 2.25, 2.5))
