"""Table I as published, and the intervals that it allows."""

import pytest

from trocar.tasks.debridement.report.table_one import MODES, PARTS, PERSON, TABLE_1, clopper_pearson
from trocar.tasks.debridement.score import FragmentScore


@pytest.mark.parametrize("column", TABLE_1.values(), ids=list(TABLE_1))
def test_parts_add_up_to_the_time_of_a_fragment(column):
    assert sum(column.shares.values()) == pytest.approx(100.0)
    assert sum(column.parts_s.values()) == pytest.approx(column.s_per_fragment)
    assert set(column.parts_s) <= set(PARTS) and set(column.failures) <= set(MODES)


def test_the_nine_modes_are_fields_of_a_score():
    assert len(MODES) == 9 and set(MODES) <= set(FragmentScore.__dataclass_fields__)


def test_intervals_are_those_of_counts():
    """Against Clopper and Pearson's closed form at 0, and tabulated 2 of 56."""
    assert clopper_pearson(0, 60) == pytest.approx((0.0, 1 - 0.025 ** (1 / 60)))
    assert clopper_pearson(2, 56) == pytest.approx((0.0044, 0.1231), abs=1e-4)
    assert clopper_pearson(60, 60) == pytest.approx((0.025 ** (1 / 60), 1.0))


def test_every_published_rate_lies_in_its_interval():
    for column in (PERSON, *TABLE_1.values()):
        for mode in MODES:
            low, high = column.interval(mode)
            assert low <= column.rate(mode) <= high < 0.21
