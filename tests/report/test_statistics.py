import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.report import Spread, wilson_interval


@pytest.mark.parametrize(
    ("succeeded", "attempted", "low", "high"),
    [(0, 10, 0.0, 0.2775), (8, 10, 0.4902, 0.9433), (120, 120, 0.9690, 1.0), (0, 0, 0.0, 1.0)],
)
def test_wilson_interval_as_in_the_tables(succeeded, attempted, low, high):
    assert wilson_interval(succeeded, attempted) == pytest.approx((low, high), abs=1e-4)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_bounds_are_where_the_score_test_just_rejects(case):
    succeeded, attempted = case
    rate = succeeded / attempted
    for bound in wilson_interval(succeeded, attempted):
        if 0 < bound < 1:
            z = (rate - bound) / math.sqrt(bound * (1 - bound) / attempted)
            assert abs(z) == pytest.approx(1.95996, abs=1e-4)


def test_more_successes_than_attempts_are_refused():
    with pytest.raises(TrocarError, match="3 successes of 2"):
        wilson_interval(3, 2)


def test_spread():
    spread = Spread.of([1.0, 2.0, 3.0, 4.0])
    assert (spread.count, spread.mean, spread.p50) == (4, 2.5, 2.5)
    assert spread.sd == pytest.approx(1.2909944)
    assert math.isnan(Spread.of([]).mean)
    assert math.isnan(Spread.of([1.0]).sd)
