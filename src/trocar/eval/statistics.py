"""Values grouped by session, and success rates with their intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln

from trocar.errors import InvalidInput

Z_95 = 1.959963984540054  # 97.5 % quantile of the standard normal
GRID = 400
"""Number of points of the grids over mean rate and correlation."""


class InSession(Protocol):
    """A value that belongs to one session, such as a trial."""

    @property
    def session(self) -> int:
        """Return the session's number."""
        ...


Thing = TypeVar("Thing", bound=InSession)
Value = TypeVar("Value")


def by_session(things: Sequence[Thing], value: Callable[[Thing], Value]) -> dict[int, list[Value]]:
    """Return the value of each thing, grouped by session."""
    found: dict[int, list[Value]] = {}
    for thing in things:
        found.setdefault(thing.session, []).append(value(thing))
    return found


def wilson_interval(succeeded: int, attempted: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate of independent attempts (Wilson 1927); (0, 1) without attempts.

    Unlike the normal approximation it stays inside [0, 1] and is valid at 120 of 120.
    """
    if not 0 <= succeeded <= attempted:
        raise _impossible(succeeded, attempted)
    if attempted == 0:
        return 0.0, 1.0
    rate, z2 = succeeded / attempted, Z_95**2
    middle = rate + z2 / (2 * attempted)
    half = Z_95 * sqrt(rate * (1 - rate) / attempted + z2 / (4 * attempted**2))
    scale = 1 + z2 / attempted
    low = 0.0 if succeeded == 0 else (middle - half) / scale
    high = 1.0 if succeeded == attempted else (middle + half) / scale
    return low, high


def session_interval(succeeded: Sequence[int], attempted: Sequence[int]) -> tuple[float, float]:
    """Return the 95 % interval of a success rate over sessions that differ; (0, 1) without attempts.

    Attempts of one session share its cables and its registration, so they are not independent evidence. The rates of
    sessions are modelled as drawn from a beta distribution whose mean is estimated (beta-binomial model). The mean has
    Jeffreys' prior Beta(1/2, 1/2), the correlation within sessions (ICC) the prior Beta(1, 2), and the interval is the
    central one of the mean's posterior. It is valid if all attempts succeeded, counts sessions rather than attempts,
    and is wide for a single session. Its coverage is tested in ``tests/eval/test_statistics.py``.

    Args:
        succeeded: number of successes in each session.
        attempted: number of attempts in each session.

    Raises:
        InvalidInput: a session has more successes than attempts, or fewer than 0.
    """
    y, n = np.asarray(succeeded, dtype=np.float64), np.asarray(attempted, dtype=np.float64)
    if y.shape != n.shape or (y < 0).any() or (y > n).any():
        raise _impossible(list(succeeded), list(attempted))
    if not n.any():
        return 0.0, 1.0
    weight = session_posterior(succeeded, attempted)[1]
    cumulative = np.concatenate([[0.0], np.cumsum(weight)]) / weight.sum()
    low, high = np.interp([0.025, 0.975], cumulative, np.arange(GRID + 1) / GRID)
    total = float(y.sum() / n.sum())
    return (0.0 if total == 0 else min(float(low), total)), (1.0 if total == 1 else max(float(high), total))


def _impossible(succeeded: object, attempted: object) -> InvalidInput:
    return InvalidInput(f"{succeeded} successes", f"of {attempted} attempts", "give 0 <= successes <= attempts")


def session_posterior(
    succeeded: Sequence[int], attempted: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the posterior of the mean rate over sessions (:func:`session_interval`): rates and weights."""
    y, n = np.asarray(succeeded, dtype=np.float64), np.asarray(attempted, dtype=np.float64)
    y, n = y[n > 0], n[n > 0]
    mean = (np.arange(GRID) + 0.5) / GRID
    icc = (np.arange(GRID) + 0.5) / GRID
    precision = 1.0 / icc - 1.0  # a + b of the beta distribution
    a, b = mean[:, None] * precision, (1.0 - mean[:, None]) * precision
    log_likelihood = np.zeros((GRID, GRID))
    for pair, count in zip(*np.unique(np.column_stack([y, n]), axis=0, return_counts=True), strict=True):
        log_likelihood += count * (betaln(a + pair[0], b + pair[1] - pair[0]) - betaln(a, b))
    log_posterior = log_likelihood - 0.5 * (np.log(mean) + np.log1p(-mean))[:, None] + np.log1p(-icc)
    return mean, np.exp(log_posterior - log_posterior.max()).sum(axis=1)
