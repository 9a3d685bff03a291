"""Rates with their intervals, and times with their spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from trocar.errors import TrocarError

Z_95 = 1.959963984540054  # 97.5 % quantile of the standard normal


def wilson_interval(succeeded: int, attempted: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate (Wilson 1927); of no attempts it is (0, 1).

    Unlike the textbook's normal interval it stays inside [0, 1] and is honest at 120 of 120.
    """
    if not 0 <= succeeded <= attempted:
        raise TrocarError(f"{succeeded} successes of {attempted} attempts; give 0 <= successes <= attempts")
    if attempted == 0:
        return 0.0, 1.0
    rate, z2 = succeeded / attempted, Z_95**2
    middle = rate + z2 / (2 * attempted)
    half = Z_95 * sqrt(rate * (1 - rate) / attempted + z2 / (4 * attempted**2))
    scale = 1 + z2 / attempted
    low = 0.0 if succeeded == 0 else (middle - half) / scale
    high = 1.0 if succeeded == attempted else (middle + half) / scale
    return low, high


@dataclass(frozen=True)
class Spread:
    """Summary of a list of numbers.

    Attributes:
        count: how many there are.
        mean: NaN of none.
        sd: standard deviation of the sample; NaN of fewer than two.
        p50: median; NaN of none.
        p95: NaN of none.
    """

    count: int
    mean: float
    sd: float
    p50: float
    p95: float

    @staticmethod
    def of(values: Sequence[float]) -> Spread:
        """Return the summary of the values."""
        x = np.asarray(values, dtype=np.float64)
        if not len(x):
            return Spread(0, *(float("nan"),) * 4)
        sd = float(np.std(x, ddof=1)) if len(x) > 1 else float("nan")
        return Spread(len(x), float(np.mean(x)), sd, *(float(p) for p in np.percentile(x, [50, 95])))
