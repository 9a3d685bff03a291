"""What counts as a red block's colour, on both sides of each limit."""

import numpy as np
import pytest

from trocar.perception.color import red_mask


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
