"""The time line beside a scene: bars where the spans are, the present, errors of the tips."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from made_up_replay import made_up_replay
from trocar.view.stage import ARMS, CONTACT
from trocar.view.timeline import (
    AXIS_PX,
    FAILED,
    INK,
    NAMES_PX,
    PAPER,
    ROW_PX,
    STRIP_PX,
    WIDTH_PX,
    WINDOW_S,
    ErrorStrip,
    LiveTimeLine,
    TimeLine,
)

REPLAY = made_up_replay(12.0)
TICK = 650
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
    assert colour_at(LINE.near(9.0), "right", (10.5 - 9.0 + WINDOW_S) / (2 * WINDOW_S)) == LINE.colours["wait"]
    assert colour_at(LINE.near(9.0), "right", (9.5 - 9.0 + WINDOW_S) / (2 * WINDOW_S)) == PAPER
    assert colour_at(LINE.near(0.0), "left", 0.3) == LINE.colours["move"]
    assert colour_at(LINE.near(40.0), "right", 0.01) == LINE.colours["wait"]


def test_the_axis_has_ticks_within_the_picture_only():
    names = TimeLine(SPANS, 0.3, 39.2).whole(0.3)[-AXIS_PX:, 30 : NAMES_PX - 1]
    assert (names == PAPER).all()


def test_a_short_trial_is_shown_whole_close_up():
    short = TimeLine((("arm", "move", 0.0, 2.0),), 0.0, 2.0)
    assert short.near(1.0).shape == short.whole(1.0).shape == (ROW_PX + AXIS_PX, WIDTH_PX, 3)


def test_the_legend_names_every_span_once_and_escapes_it():
    legend = TimeLine((("a", "<b>", 0, 1), ("b", "<b>", 1, 2)), 0.0, 2.0).legend()
    assert legend.count("&lt;b&gt;") == 1
    assert "<b>" not in legend


def column(time_s):
    return NAMES_PX + round(time_s / 12.0 * (WIDTH_PX - NAMES_PX))


def test_the_strip_draws_each_tips_distance_from_where_it_was_planned():
    path = REPLAY.tools["psm1"]
    off_mm = 1e3 * np.linalg.norm(path.p_world_driven_m - path.p_world_planned_m, axis=1)
    strip = ErrorStrip(replace(REPLAY, tools={"psm1": path}, contacts=(), goals=()))
    assert strip.top_mm == pytest.approx(max(off_mm.max(), 2.0))
    assert strip.said(TICK) == f"psm1 {off_mm[TICK]:.1f} mm"
    picture = strip.at(0.0)
    for time_s in (2.0, 5.5, 9.0):
        rows = np.flatnonzero((picture[:, column(time_s)] == ARMS[0]).all(-1))
        tick = round(100 * time_s)
        wanted = (STRIP_PX - 4) * (1 - off_mm[tick - 5 : tick + 6] / strip.top_mm) + 1
        assert wanted.min() - 4 <= rows.mean() <= wanted.max() + 4


def test_contacts_missed_goals_and_the_present_are_lines_in_the_strip():
    strip = ErrorStrip(replace(REPLAY, goals=tuple(replace(g, end_s=g.end_s - 1.0) for g in REPLAY.goals)))
    picture = strip.at(7.0)
    assert (picture[3, column(2.2)] == CONTACT).all()
    assert (picture[3, column(11.0)] == FAILED).all()
    assert not (picture[3, column(5.0)] == FAILED).all()  # that goal was reached
    assert (picture[:, column(7.0)] == INK).all()


def test_a_tip_that_nobody_knows_for_a_while_leaves_a_gap():
    path = REPLAY.tools["psm1"]
    gaps = np.where((np.arange(1201) < 300)[:, None], np.nan, path.p_world_driven_m)
    strip = ErrorStrip(replace(REPLAY, tools={"psm1": replace(path, p_world_driven_m=gaps)}, contacts=(), goals=()))
    assert np.isfinite(strip.top_mm)
    assert not (strip.at(12.0)[:-3, column(1.0)] == ARMS[0]).all(-1).any()


class Gui:
    """A panel that keeps what is put into it."""

    def add_html(self, content):
        return SimpleNamespace(content=content)

    def add_image(self, image, format):
        return SimpleNamespace(image=image, visible=True)


def test_a_live_line_ends_with_the_present_and_the_spans_that_have_not_ended():
    line = LiveTimeLine(Gui())
    line.add([("left", "move", 0.0, 4.0), ("right", "wait", 4.0, 11.0)])
    line.show(20.0, [("left", "grasp", 15.0)])
    assert "<b>left</b> grasp" in line._now.content

    def colour(row, share):
        return tuple(line._picture.image[ROW_PX * row + 5, NAMES_PX + round(share * (WIDTH_PX - NAMES_PX))].tolist())

    colours = TimeLine([], 0.0, 20.0, ("move", "wait", "grasp")).colours
    assert colour(0, 0.9) == colours["grasp"] and colour(0, 0.4) == PAPER
    assert colour(1, 0.05) == colours["wait"] and colour(1, 0.15) == PAPER
    assert (line._picture.image[:ROW_PX, -1] == INK).all()
    assert len(line._spans) == 1  # what is past is not kept


def test_a_live_line_without_steps_is_no_picture():
    line = LiveTimeLine(Gui())
    line.add([("left", "<b>", 0.0, 1.0)])
    line.show(1.0, [("left", "<i>", 0.5)])
    assert line._picture.visible and "<i>" not in line._now.content + line._legend.content
    line.clear()
    line.show(2.0, [])
    assert not line._picture.visible and "no step" in line._now.content
