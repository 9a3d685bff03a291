"""Interval arithmetic on arrays: each result encloses every value that reals within the operands can give."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

WIDER = 1e-15
"""Results are widened by this share of themselves: more than four units in the last place, in any rounding mode."""
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Interval:
    """Intervals [low, high], one per element; unbounded where nothing better is known.

    Supports ``+ - * /`` with intervals and floats, and ``abs``; ``x * x`` of one and the same object is its square.

    Attributes:
        low: array of any shape.
        high: array of the same shape.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @staticmethod
    def around(low: ArrayLike, high: ArrayLike) -> Interval:
        """Return the intervals between these floats, widened by the rounding error with which they were computed."""
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        below, above = low - (WIDER * np.abs(low) + TINY), high + (WIDER * np.abs(high) + TINY)
        return Interval(np.fmax(below, -np.inf), np.fmin(above, np.inf))  # NaN, as of inf - inf: unbounded

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __abs__(self) -> Interval:
        smallest = np.maximum(np.maximum(self.low, -self.high), 0.0)
        return Interval(smallest, np.maximum(np.abs(self.low), np.abs(self.high)))

    def __add__(self, other: Interval | float) -> Interval:
        low, high = _ends(other)
        return Interval.around(self.low + low, self.high + high)

    __radd__ = __add__

    def __sub__(self, other: Interval | float) -> Interval:
        low, high = _ends(other)
        return Interval.around(self.low - high, self.high - low)

    def __rsub__(self, other: float) -> Interval:
        return -self + other

    def __mul__(self, other: Interval | float) -> Interval:
        if other is self:
            return self.square()
        low, high = _ends(other)
        a, b, c, d = self.low * low, self.low * high, self.high * low, self.high * high
        return Interval.around(
            np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | float) -> Interval:
        low, high = _ends(other)
        apart = (low > 0) | (high < 0)
        inverse = Interval(np.where(apart, 1.0 / high, -np.inf), np.where(apart, 1.0 / low, np.inf))
        return self * Interval.around(inverse.low, inverse.high)

    def __getitem__(self, index: object) -> Interval:
        return Interval(self.low[index], self.high[index])  # type: ignore[index]

    @property
    def middle(self) -> NDArray[np.float64]:
        """Return the middle; NaN where an interval is unbounded on both sides."""
        return (self.low + self.high) / 2

    @property
    def width(self) -> NDArray[np.float64]:
        """Return high minus low."""
        return self.high - self.low

    def square(self) -> Interval:
        """Return the squares."""
        size = abs(self)
        return Interval.around(size.low**2, size.high**2)

    def sqrt(self) -> Interval:
        """Return the square roots, 0 of negative numbers."""
        return Interval.around(np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0)))

    def arctan(self) -> Interval:
        """Return the arctangents."""
        return Interval.around(np.arctan(self.low), np.arctan(self.high))

    def cos(self) -> Interval:
        """Return the cosines."""
        here = Interval.around(self.low, self.high)
        at_low, at_high = np.cos(here.low), np.cos(here.high)
        # multiples of pi within the interval: cos has a crest at even ones and a trough at odd ones
        first = np.ceil(here.low / math.pi - 1e-12)
        many = here.high / math.pi + 1e-12 - first
        even = np.floor(first / 2) * 2 == first
        crest, trough = (many >= 1) | ((many >= 0) & even), (many >= 1) | ((many >= 0) & ~even)
        unbounded = ~np.isfinite(here.width)
        return Interval.around(
            np.where(trough | unbounded, -1.0, np.minimum(at_low, at_high)),
            np.where(crest | unbounded, 1.0, np.maximum(at_low, at_high)),
        )

    def sin(self) -> Interval:
        """Return the sines."""
        return (self - math.pi / 2).cos()

    def hull(self, other: Interval) -> Interval:
        """Return the smallest intervals that contain both."""
        return Interval(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def where(self, condition: ArrayLike, other: Interval) -> Interval:
        """Return these intervals where the condition holds, and the others elsewhere."""
        return Interval(np.where(condition, self.low, other.low), np.where(condition, self.high, other.high))


class IntervalMath:
    """The functions that ``closed_form`` of the arms needs, for intervals."""

    @staticmethod
    def sqrt(x: Interval) -> Interval:
        """Return the square roots, 0 of negative numbers."""
        return x.sqrt()

    root = sqrt

    @staticmethod
    def copysign(x: Interval, sign: Interval) -> Interval:
        """Return x >= 0 with the sign of another interval; from -x to x where that may be either."""
        above, below = sign.low > 0, sign.high < 0
        return Interval(np.where(above, x.low, -x.high), np.where(below, -x.low, x.high))

    @staticmethod
    def atan2_right(y: Interval, x: Interval) -> Interval:
        """Return the angles of (x, y) with x >= 0."""
        return (y / x).arctan()

    @staticmethod
    def atan2(y: Interval, x: Interval) -> Interval:
        """Return the angles of (x, y), up to whole turns; unbounded where (x, y) may lie on any side of the origin."""
        # turned by the angle of the box's middle, the rest is small, and its tangent a quotient that stays bounded
        angle = np.arctan2(np.nan_to_num(y.middle), np.nan_to_num(x.middle))
        at, c, s = Interval.around(angle, angle), np.cos(angle), np.sin(angle)
        cosine, sine = Interval.around(c, c), Interval.around(s, s)
        ahead, aside = cosine * x + sine * y, cosine * y - sine * x
        return at.where(ahead.low > 0, Interval(*np.broadcast_arrays(-np.inf, np.inf))) + (aside / ahead).arctan()


def _ends(value: Interval | float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if isinstance(value, Interval):
        return value.low, value.high
    end = np.asarray(value, dtype=np.float64)
    return end, end
