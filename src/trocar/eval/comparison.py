"""Comparisons between conditions in the same sessions; the unit is the session, not the trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from trocar.errors import InvalidInput
from trocar.eval.statistics import session_posterior

EXACT_UP_TO = 1 << 14
"""All sign patterns are counted up to this number; of more, this many are drawn."""
DRAWS = 10_000
"""Number of resamples of the sessions for the interval of a ratio."""


@dataclass(frozen=True)
class Estimate:
    """A mean over sessions.

    Attributes:
        mean: mean of the sessions' means.
        low: lower end of the 95 % interval; None for a single session.
        high: upper end; None for a single session.
    """

    mean: float
    low: float | None
    high: float | None

    def not_negative(self) -> Estimate:
        """Return the estimate of what is never negative, such as a count: the interval does not go below 0."""
        return self if self.low is None else replace(self, low=max(0.0, self.low))


@dataclass(frozen=True)
class Difference:
    """One condition minus another, session by session.

    Attributes:
        sessions: number of sessions that both conditions have.
        mean: mean of the differences; NaN without a session.
        low: lower end of the 95 % interval of Student's t; None for fewer than two sessions.
        high: upper end, likewise.
        p: probability of a mean at least this far in the tested direction by chance (one-sided).
    """

    sessions: int
    mean: float
    low: float | None
    high: float | None
    p: float


def session_estimate(values: Mapping[int, Sequence[float]]) -> Estimate:
    """Return the mean over sessions with the 95 % interval of Student's t over the sessions' means.

    Args:
        values: the trials' values, by session.

    Raises:
        InvalidInput: there is no session.
    """
    means = np.array([np.mean(of_session) for of_session in values.values() if len(of_session)])
    if not len(means):
        raise InvalidInput("there", "is no session to average over", "run some trials")
    return Estimate(float(means.mean()), *_student(means))


Pairs = Mapping[int, Sequence[tuple[float, float]]]
"""Numerator and denominator of each trial, by session."""


def ratio_estimate(values: Pairs) -> Estimate | None:
    """Return a ratio of sums with its 95 % interval over sessions; None if the denominators are all 0.

    The interval is Student's t over the deviations of the sessions' numerators from the common ratio (linearised,
    Cochran 1977). If all sessions have the same denominator, it equals the interval of :func:`session_estimate`.

    Args:
        values: numerators and denominators of the trials, by session.
    """
    sums = _sums(values, list(values))
    if sums[:, 1].sum() <= 0:
        return None
    ratio = float(sums[:, 0].sum() / sums[:, 1].sum())
    low, high = _student((sums[:, 0] - ratio * sums[:, 1]) / sums[:, 1].mean())
    return Estimate(ratio, None if low is None else ratio + low, None if high is None else ratio + high)


def ratio_of_ratios(first: Pairs, second: Pairs) -> Estimate | None:
    """Return one ratio of sums over another, over the sessions that both have; None if a divisor is 0.

    The 95 % interval is the percentile bootstrap over sessions, with the same resamples for both. With few sessions it
    is somewhat narrow. Resamples with a divisor of 0 are left out.

    Args:
        first: numerators and denominators of the trials, by session.
        second: likewise; the divisor.
    """
    both = [session for session in first if session in second]
    one, two = _sums(first, both), _sums(second, both)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = _divided(one.sum(axis=0), two.sum(axis=0))
        if not np.isfinite(found):
            return None
        if len(both) < 2:
            return Estimate(float(found), None, None)
        drawn = np.random.default_rng(0).integers(len(both), size=(DRAWS, len(both)))
        ratios = _divided(one[drawn].sum(axis=1), two[drawn].sum(axis=1))
    ratios = ratios[np.isfinite(ratios)]
    low, high = np.percentile(ratios, [2.5, 97.5])
    return Estimate(float(found), float(low), float(high))


def _sums(values: Pairs, sessions: Sequence[int]) -> NDArray[np.float64]:
    """Return the sums (n, 2) of numerators and denominators of sessions."""
    return np.array([np.sum(values[session], axis=0) for session in sessions], dtype=np.float64).reshape(-1, 2)


def _divided(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first ratio over the second; NaN if one of them is unknown, or the second is 0."""
    below = one[..., 1] * two[..., 0]
    return np.where((below > 0) & (two[..., 1] > 0), one[..., 0] * two[..., 1] / below, np.nan)


def session_difference(
    first: Mapping[int, Sequence[float]], second: Mapping[int, Sequence[float]], *, less: bool
) -> Difference:
    """Return the difference between two conditions in the same sessions.

    Each session gives one difference of means. If the conditions did not differ, each difference could equally have the
    other sign. So p is the share of all sign patterns (of drawn ones for more than 14 sessions) with a mean at least as
    far in the tested direction. It assumes no distribution, and with n sessions it cannot be below 2^-n.

    Args:
        first: values of the trials, by session.
        second: likewise; it is subtracted.
        less: whether the first is expected to be less; else more.
    """
    both = [session for session in first if len(first[session]) and len(second.get(session, ()))]
    d = np.array([np.mean(first[session]) - np.mean(second[session]) for session in both])
    if not len(d):
        return Difference(0, float("nan"), None, None, 1.0)
    return Difference(len(d), float(d.mean()), *_student(d), _sign_flips(d if less else -d))


def _student(values: NDArray[np.floating]) -> tuple[float | None, float | None]:
    """Return the 95 % interval of the mean."""
    n = len(values)
    if n < 2:
        return None, None
    half = float(stats.t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n))
    return float(values.mean()) - half, float(values.mean()) + half


def _sign_flips(d: NDArray[np.floating]) -> float:
    """Return the share of sign patterns with a mean as low as the one found, or lower."""
    if len(d) == 1:
        return 0.5 if d[0] < 0 else 1.0
    found = stats.permutation_test(
        (d,),
        lambda x, axis: np.mean(x, axis=axis),
        permutation_type="samples",
        vectorized=True,
        alternative="less",
        n_resamples=EXACT_UP_TO,
        rng=np.random.default_rng(0),
    )
    return float(found.pvalue)


def rate_difference(
    first: tuple[Sequence[int], Sequence[int]], second: tuple[Sequence[int], Sequence[int]], share: float = 0.95
) -> tuple[float, float]:
    """Return the interval of the difference of two success rates over sessions.

    The rates have the posteriors of :func:`trocar.eval.statistics.session_interval`, treated as independent, which is
    conservative if the sessions are the same. The interval is also valid if everything succeeded.

    Args:
        first: successes and attempts of each session.
        second: likewise; it is subtracted.
        share: share of the posterior inside the interval.
    """
    middles, one = session_posterior(*first)
    two = session_posterior(*second)[1]
    weights = np.convolve(one, two[::-1])
    grid = (np.arange(len(weights)) - (len(middles) - 1)) * (middles[1] - middles[0])
    cumulative = (np.cumsum(weights) - weights / 2.0) / weights.sum()  # half of a bin's weight is below its middle
    tail = (1.0 - share) / 2.0
    low, high = np.interp([tail, 1.0 - tail], cumulative, grid)
    return float(low), float(high)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for multiple tests (Holm 1979): those below .05 hold jointly at 95 %."""
    order = np.argsort(p_values)
    adjusted = np.empty(len(order))
    worst = 0.0
    for rank, place in enumerate(order):
        worst = max(worst, (len(order) - rank) * p_values[place])
        adjusted[place] = min(1.0, worst)
    return adjusted.tolist()
