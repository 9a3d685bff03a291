"""The Raven's numbers in the units of their sources (facts/debridement.md), and its colours."""

import colorsys
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import RAVEN2_LEFT, RAVEN2_RIGHT
from trocar.arms.solids import STEEL

BOTH = pytest.mark.parametrize("arm", [RAVEN2_LEFT, RAVEN2_RIGHT], ids=lambda arm: arm.name)
UNITS = np.array([np.pi / 180, np.pi / 180, 1e-3, np.pi / 180, np.pi / 180, np.pi / 180])
"""deg and mm."""


@BOTH
def test_ranges_lengths_and_limits_are_those_of_the_source(arm):
    assert_allclose(arm.lower / UNITS, [0, 45, 230, -182, -75, -90])
    assert_allclose(arm.upper / UNITS, [90, 135, 560, 182, 75, 90])
    assert_allclose(np.degrees([arm.jaw.lower, arm.jaw.upper]), [0, 120])
    assert (arm.wrist_length_m, arm.tip_length_m) == (0.013, 0.010)
    assert arm.safe_depth_m == 0.045, "as on the dVRK"
    assert_allclose(arm.motion_limits.velocity, [3, 3, 0.1, 3, 3, 3])
    assert_allclose(arm.motion_limits.acceleration, [1, 1, 0.1, 1, 1, 1])
    assert (arm.jaw.max_speed, arm.jaw.max_acceleration) == (3, 1)


def test_four_colours_are_told_apart_by_their_hue_from_each_other_and_from_steel_and_tissue():
    colours = [*RAVEN2_LEFT.instrument.marks.colors, *RAVEN2_RIGHT.instrument.marks.colors]
    hues = []
    assert colorsys.rgb_to_hsv(*STEEL)[1] < 0.1
    for rgb in colours:
        assert min(rgb) >= 0.0 and max(rgb) < 1.0
        hue, saturation, _ = colorsys.rgb_to_hsv(*rgb)
        assert saturation > 0.7
        hues.append(360 * hue)
    assert_allclose(hues, [46, 131, 228, 302], atol=5)  # yellow, green, blue, magenta
    apart = [min((a - b) % 360, (b - a) % 360) for a, b in combinations([*hues, 0.0], 2)]
    assert min(apart) > 40, "red is 0"
    assert min(max(rgb) for rgb in colours) > 0.4, "all are bright enough to be seen"
