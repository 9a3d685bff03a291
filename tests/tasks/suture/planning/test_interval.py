import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.tasks.suture.planning.interval import Interval, IntervalMath

seeds = st.integers(0, 2**32 - 1)
COUNT, SAMPLES = 60, 40
ANGLES = {"cos": np.cos, "sin": np.sin, "arctan": np.arctan}


def some(rng, scale=3.0):
    """Return intervals (n,), narrow and wide, and values in them (n, m), ends included."""
    low = rng.uniform(-scale, scale, COUNT)
    high = low + rng.choice([0.0, 1e-12, 1e-3, 1.0, 8.0], COUNT) * rng.random(COUNT)
    part = np.concatenate([[0.0, 1.0], rng.random(SAMPLES)])
    return Interval(low, high), np.clip(low[:, None] * (1 - part) + high[:, None] * part, low[:, None], high[:, None])


def holds(interval, values):
    return np.all((interval.low[:, None] <= values) & (values <= interval.high[:, None]))


@given(seed=seeds)
def test_arithmetic_encloses(seed):
    rng = np.random.default_rng(seed)
    (one, x), (other, y) = some(rng), some(rng)
    with np.errstate(all="ignore"):
        assert holds(one + other, x + y) and holds(one - other, x - y) and holds(one * other, x * y)
        assert holds(2.5 - one, 2.5 - x) and holds(one * -2.0, -2 * x) and holds(one / 3.0, x / 3)
        quotient = one / other
        assert holds(quotient, np.where(y == 0, 0.0, x / np.where(y == 0, 1.0, y)))
        spans_zero = (other.low <= 0) & (other.high >= 0)
        assert np.all(np.isinf(quotient.low[spans_zero])) and np.all(np.isfinite(quotient.width[~spans_zero]))
        assert holds(one * one, x * x) and holds(abs(one), np.abs(x))
        assert holds(abs(one).sqrt(), np.sqrt(np.abs(x)))
        assert np.all((one * one).low >= -1e-290)  # a square, not a product of independent factors


@given(seed=seeds)
def test_functions_enclose_and_are_tight(seed):
    one, x = some(np.random.default_rng(seed), 20.0)
    for name, function in ANGLES.items():
        found = getattr(one, name)()
        assert holds(found, function(x)), name
        dense = function(np.linspace(one.low, one.high, 4001))
        np.testing.assert_allclose(found.low, dense.min(0), atol=1e-4)
        np.testing.assert_allclose(found.high, dense.max(0), atol=1e-4)


@given(seed=seeds)
def test_angles_of_points_enclose_up_to_whole_turns(seed):
    rng = np.random.default_rng(seed)
    (y, some_y), (x, some_x) = some(rng), some(rng)
    with np.errstate(all="ignore"):
        found = IntervalMath.atan2(y, x)
        angle = np.arctan2(some_y, some_x)
        middle = np.where(np.isfinite(found.width), found.middle, 0.0)[:, None]
        assert holds(found, angle + 2 * np.pi * np.rint((middle - angle) / (2 * np.pi)))
        around = (x.low <= 0) & (x.high >= 0) & (y.low <= 0) & (y.high >= 0)
        assert np.all(np.isinf(found.width[around]))
        small = (x.width + y.width < 1e-3) & (np.hypot(x.middle, y.middle) > 0.1)
        assert np.all(found.width[small] < 0.03)
        right = x.low > 0
        assert holds(IntervalMath.atan2_right(y[right], x[right]), angle[right])
    signed = IntervalMath.copysign(abs(y), x)
    assert holds(signed, np.copysign(np.abs(some_y), some_x))


def test_rounding_is_outward():
    third = Interval.around(1.0, 1.0) / 3.0
    assert third.low < 1 / 3 < third.high
    total = Interval.around(0.0, 0.0)
    for _ in range(10):
        total = total + Interval.around(0.1, 0.1)
    assert total.low < 1.0 < total.high and total.width < 1e-13


def test_what_is_unbounded_stays_so():
    with np.errstate(all="ignore"):
        every = Interval(np.array([-np.inf]), np.array([np.inf]))
        for found in (every * 0.0, every - every, every * every, every / every):
            assert found.high[0] == np.inf
        assert every.cos().low[0] <= -1 and every.cos().high[0] >= 1
        assert every.arctan().high[0] == pytest.approx(math.pi / 2)
