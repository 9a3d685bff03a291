"""Panels beside a scene: joints, timeline, figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import JOINTS, made_up_replay
from trocar.errors import TrocarError
from trocar.view.panels import (
    AXIS_PX,
    INK,
    NAMES_PX,
    PAPER,
    POINTS,
    ROW_PX,
    WIDTH_PX,
    WINDOW_S,
    Joints,
    TimeLine,
)

REPLAY = made_up_replay(12.0)
TICK = 650


def joints(*kinds):
    return Joints.of(replace(REPLAY, joints={"psm1": {k: REPLAY.joints["psm1"][k] for k in kinds}}), "psm1")


def test_the_table_has_every_joint_in_its_unit_with_its_error():
    table = Joints.of(REPLAY, "psm1").table(TICK).splitlines()
    assert table[0] == "| joint | desired | commanded | measured | true | true - desired |"
    assert len(table) == 2 + 7
    true, asked = (REPLAY.joints["psm1"][kind][TICK] for kind in ("true", "desired"))
    for k, (row, name) in enumerate(zip(table[2:], JOINTS, strict=True)):
        scale, unit = (1e3, "mm") if name == "insertion" else (180 / np.pi, "deg")
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[0] == f"{name.replace('_', ' ')}, {unit}"
        assert float(cells[1]) == pytest.approx(scale * asked[k], abs=0.051)
        assert float(cells[-1].strip("*")) == pytest.approx(scale * (true - asked)[k], abs=0.0051)


def test_what_there_is_is_compared_under_the_names_that_there_are():
    one, two = joints("true"), joints("commanded", "measured")
    assert one.table(0).splitlines()[0] == "| joint | true |"
    assert two.table(0).splitlines()[0] == "| joint | commanded | measured | measured - commanded |"
    assert Joints.of(replace(REPLAY, joints={}), "psm1") is None
    assert "joint 1, deg" in Joints.of(replace(REPLAY, joint_names={}), "psm1").table(0)


def test_curves_are_errors_in_degrees_about_now():
    seconds, commanded, measured, true = Joints.of(REPLAY, "psm1").errors_near(TICK, 4)
    assert_allclose(seconds[[0, -1]], [-WINDOW_S, WINDOW_S], atol=0.06)
    assert len(seconds) <= 2 * POINTS
    assert_allclose(np.degrees(0.002), commanded)
    assert_allclose(np.degrees(0.001), measured)
    assert_allclose(true, -np.degrees(0.01) * np.sin(0.8 * (6.5 + seconds)), atol=1e-9)
    first = Joints.of(REPLAY, "psm1").errors_near(0, 0)[0]
    assert_allclose(first[[0, -1]], [0, WINDOW_S], atol=0.06)  # none before the trial


def test_arrays_of_another_shape_are_told():
    with pytest.raises(TrocarError, match=r"the true joints of 'psm1' have shape \(3, 7\); give \(1201, 7\)"):
        Joints.of(replace(REPLAY, joints={"psm1": {"true": np.zeros((3, 7))}}), "psm1")


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
