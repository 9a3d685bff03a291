"""Colours that count, on both sides of each limit: shares of red, and ranges of hue."""

import numpy as np
import pytest

from trocar.perception.color import RED_FOAM, HueRange, red_mask, to_hsv


@pytest.mark.parametrize(
    ("taken", "left"),
    [
        ((24, 0, 0), (23, 0, 0)),  # too dark to tell
        ((101, 50, 50), (100, 50, 50)),  # half of the light is red
        ((91, 60, 0), (90, 60, 0)),  # orange, and yellow
        ((200, 31, 50), (200, 29, 50)),  # a red that tends to purple
    ],
)
def test_a_pixel_is_red_up_to_a_limit(taken, left):
    assert red_mask(np.array([[taken, left]], np.uint8)).tolist() == [[True, False]]


def has(colors: HueRange, *pixels) -> list[bool]:
    """Return which HSV pixels have such a colour."""
    found = colors.mask(np.array([pixels], np.uint8))[0]
    assert set(found.tolist()) <= {0, 255}
    return (found == 255).tolist()


def test_hues_go_round():
    picture = np.array(
        [[[200, 20, 20], [200, 20, 40], [200, 120, 20], [20, 20, 200], [60, 8, 8], [30, 5, 5]]], np.uint8
    )
    assert (RED_FOAM.mask(to_hsv(picture))[0] > 0).tolist() == [True, True, False, False, True, False]
    blue = HueRange.around((0.02, 0.14, 0.62))
    assert (blue.mask(to_hsv(picture))[0] > 0).tolist() == [False, False, False, True, False, False]


def test_both_ends_of_a_range_belong_to_it():
    green = HueRange(50, 70, 100, 40)
    assert has(green, (49, 200, 200), (50, 200, 200), (70, 200, 200), (71, 200, 200)) == [False, True, True, False]
    assert has(green, (60, 100, 200), (60, 99, 200), (60, 255, 40), (60, 255, 39)) == [True, False, True, False]
    assert has(green, (60, 255, 255)) == [True]
    assert has(HueRange(60, 60, 0, 0), (59, 200, 200), (60, 200, 200), (61, 200, 200)) == [False, True, False]


def test_a_range_through_zero_has_the_hues_on_both_sides_of_it():
    red = HueRange(175, 5, 0, 0)
    hues = [(hue, 200, 200) for hue in (174, 175, 179, 0, 5, 6)]
    assert has(red, *hues) == [False, True, True, True, True, False]


def test_the_foam_is_as_red_as_in_the_program_of_2014():
    hues = [(hue, 200, 200) for hue in (169, 170, 179, 0, 6, 7)]
    assert has(RED_FOAM, *hues) == [False, True, True, True, True, False]
    assert has(RED_FOAM, (0, 120, 200), (0, 119, 200), (0, 200, 50), (0, 200, 49)) == [True, False, True, False]


@pytest.mark.parametrize(
    ("rgb", "hue"), [((0.8, 0.0, 0.0), 0), ((0.0, 0.5, 0.0), 60), ((0.0, 0.0, 1.0), 120), ((0.6, 0.0, 0.3), 165)]
)
def test_the_hues_around_a_paint(rgb, hue):
    """Nine on either side, of colours that are neither pale nor dark."""
    near = HueRange.around(rgb)
    hues = [((hue + off) % 180, 255, 255) for off in (-10, -9, 0, 9, 10)]
    assert has(near, *hues) == [False, True, True, True, False]
    assert has(near, (hue, 110, 35), (hue, 109, 35), (hue, 110, 34)) == [True, False, False]
    assert has(HueRange.around(rgb, 2, 50, 20), ((hue + 3) % 180, 255, 255), (hue, 50, 20)) == [False, True]
