"""The time line's bars are where the spans are, and its line is at the present."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.view.timeline import AXIS_PX, INK, NAMES_PX, NEAR_S, PAPER, ROW_PX, WIDTH_PX, TimeLine, nice_step

SPANS = (("left", "move", 0.0, 4.0), ("left", "grasp", 4.0, 5.0), ("right", "wait", 10.0, 40.0))
LINE = TimeLine(SPANS, 0.0, 40.0)


def colour_at(picture, arm, share):
    """Return the colour of an arm's row at a share of the picture's time, at the bar's edge where there is no text."""
    row = ROW_PX * LINE.arms.index(arm) + 5
    return tuple(picture[row, NAMES_PX + round(share * (WIDTH_PX - NAMES_PX))].tolist())


@pytest.mark.parametrize(
    ("arm", "time_s", "name"),
    [("left", 1, "move"), ("left", 4.5, "grasp"), ("left", 8, None), ("right", 5, None), ("right", 20, "wait")],
)
def test_bars_stand_where_the_spans_are(arm, time_s, name):
    assert colour_at(LINE.whole(39.0), arm, time_s / 40) == (LINE.colours[name] if name else PAPER)


def test_the_line_is_at_the_present():
    for time_s in (0.0, 13.0, 40.0):
        dark = (LINE.whole(time_s)[: ROW_PX * 2, NAMES_PX:] == INK).all((0, 2))
        assert np.flatnonzero(dark).mean() == pytest.approx(time_s / 40 * (WIDTH_PX - NAMES_PX), abs=2)


def test_close_up_shows_what_is_near_and_stays_within_the_trial():
    assert colour_at(LINE.near(20.0), "right", 0.01) == LINE.colours["wait"]
    assert colour_at(LINE.near(9.0), "right", (10.5 - 9.0 + NEAR_S) / (2 * NEAR_S)) == LINE.colours["wait"]
    assert colour_at(LINE.near(9.0), "right", (9.5 - 9.0 + NEAR_S) / (2 * NEAR_S)) == PAPER
    assert colour_at(LINE.near(0.0), "left", 0.3) == LINE.colours["move"]
    assert colour_at(LINE.near(40.0), "right", 0.01) == LINE.colours["wait"]


def test_a_short_trial_is_shown_whole_close_up():
    short = TimeLine((("arm", "move", 0.0, 2.0),), 0.0, 2.0)
    assert short.near(1.0).shape == short.whole(1.0).shape == (ROW_PX + AXIS_PX, WIDTH_PX, 3)


def test_the_legend_names_every_span_once_and_escapes_it():
    legend = TimeLine((("a", "<b>", 0, 1), ("b", "<b>", 1, 2)), 0.0, 2.0).legend()
    assert legend.count("&lt;b&gt;") == 1
    assert "<b>" not in legend


@given(length=st.floats(0.01, 1e5))
def test_ticks_are_round_and_neither_crowded_nor_rare(length):
    step = nice_step(length)
    assert 4.4 < length / step < 12
    assert f"{step:.0e}"[0] in "125"
