"""An arm's time, part by part: every moment counts once."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.log import Span
from trocar.report.timechart import parts_of


def test_what_is_noted_one_after_the_other_is_counted_as_it_is():
    spans = [Span("a", "capture", 0.0, 0.2), Span("a", "motion", 0.5, 1.5), Span("a", "capture", 1.5, 1.6)]
    assert parts_of(spans, "a", 2.0) == pytest.approx({"capture": 0.3, "motion": 1.0, "other": 0.7})


def test_jaws_that_open_during_a_motion_do_not_count_twice():
    spans = [Span("a", "jaw", 0.1, 0.4), Span("a", "motion", 0.0, 1.0)]
    assert parts_of(spans, "a", 1.0) == pytest.approx({"motion": 1.0, "other": 0.0})
    longer = [Span("a", "motion", 0.0, 1.0), Span("a", "jaw", 0.8, 1.3)]
    assert parts_of(longer, "a", 1.3) == pytest.approx({"motion": 1.0, "jaw": 0.3, "other": 0.0})


def test_two_arms_have_their_own_time():
    """Once the sum over both was taken from one arm's time, and the rest was -5 s."""
    spans = [Span("a", "motion", 0.0, 9.0), Span("b", "motion", 0.0, 6.0)]
    assert parts_of(spans, "a", 10.0) == pytest.approx({"motion": 9.0, "other": 1.0})
    assert parts_of(spans, "b", 10.0) == pytest.approx({"motion": 6.0, "other": 4.0})


@given(
    st.lists(
        st.tuples(st.sampled_from("ab"), st.sampled_from(["x", "y", "z"]), st.floats(0, 9), st.floats(0, 5)),
        max_size=12,
    )
)
def test_parts_are_never_negative_and_add_up_however_spans_overlap(rows):
    spans = [Span(arm, name, start, start + length) for arm, name, start, length in rows]
    for arm in "ab":
        parts = parts_of(spans, arm, 10.0)
        assert sum(parts.values()) == pytest.approx(10.0)
        assert min(parts.values()) > -1e-9
