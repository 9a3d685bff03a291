"""The PSM's numbers in the units of their sources: facts/peg_transfer.md, "Kinematics"."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import MOTION_LIMITS, PSM_CLASSIC, PSM_SI, wrist_depth_m

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
