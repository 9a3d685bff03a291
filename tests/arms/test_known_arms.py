"""The numbers of known arms in the units of their sources (dVRK configuration, Raven II, Hwang et al. 2022)."""

import colorsys
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import MOTION_LIMITS, PSM_CLASSIC, PSM_SI, RAVEN2_LEFT, RAVEN2_RIGHT, wrist_depth_m
from trocar.arms.solids import STEEL

UNITS = np.array([np.pi / 180, np.pi / 180, 1e-3, np.pi / 180, np.pi / 180, np.pi / 180])
"""deg and mm."""


@pytest.mark.parametrize(
    ("arm", "lower", "upper"),
    [
        (PSM_CLASSIC, [-91, -53, 0, -260, -80, -80], [91, 53, 240, 260, 80, 80]),
        (PSM_SI, [-170, -72.5, 0, -260, -80, -80], [170, 74.5, 290, 260, 80, 80]),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_the_ranges_are_the_published_ones(arm, lower, upper):
    assert_allclose(arm.lower / UNITS, lower)
    assert_allclose(arm.upper / UNITS, upper)
    assert_allclose(np.degrees([arm.jaw.lower, arm.jaw.upper]), [-40, 80])


@pytest.mark.parametrize("arm", [PSM_CLASSIC, PSM_SI], ids=lambda arm: arm.name)
def test_the_motion_limits_are_those_of_the_dvrk_and_of_the_paper(arm):
    assert_allclose(arm.motion_limits.velocity / UNITS, [90, 90, 200, 1080, 1080, 1080])
    assert_allclose(arm.motion_limits.acceleration / UNITS, [90, 90, 200, 720, 720, 720])
    assert arm.jaw.max_speed == 6.0
    assert arm.jaw.max_acceleration == arm.motion_limits.acceleration[5]
    paper, dvrk = MOTION_LIMITS["paper"], MOTION_LIMITS["dvrk"]
    assert_allclose(paper.velocity / np.pi, [2, 2, 0.4 / np.pi, 12, 12, 12])
    assert_allclose(paper.acceleration / np.pi, [2, 2, 0.4 / np.pi, 8, 8, 8])
    assert dvrk is PSM_CLASSIC.motion_limits


@pytest.mark.parametrize("arm", [PSM_CLASSIC, PSM_SI], ids=lambda arm: arm.name)
def test_its_lengths_and_the_depth_that_cartesian_motion_keeps(arm):
    assert (arm.wrist_length_m, arm.tip_length_m, arm.safe_depth_m) == (0.0091, 0.0095, 0.045)
    assert wrist_depth_m(arm, np.zeros(6)) == pytest.approx(0.4162 - 0.4318)
    assert arm.coupling is not None
    roll, pitch, yaw, jaw = np.array(arm.coupling)
    assert_allclose(roll, [-1.5632, 0, 0, 0])
    assert_allclose(pitch, [0, 1.0186, 0, 0])
    assert_allclose(yaw, [0, -0.8306, 0.6089, 0.6089])  # both fingers' disks turn the wrist, and open the jaws
    assert_allclose(jaw, [0, 0, -1.2177, 1.2177])


BOTH = pytest.mark.parametrize("arm", [RAVEN2_LEFT, RAVEN2_RIGHT], ids=lambda arm: arm.name)


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
