"""The solids of an instrument, link by link, against lengths by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, frames
from trocar.arms.solids import CARBON, HOUSING, STEEL, parts_of

MM = 1e-3


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_every_solid_is_where_and_as_large_as_it_should_be(arm):
    shape, parts = arm.instrument, {part.name: part for part in parts_of(arm)}
    back = np.array([0.0, 0.0, arm.wrist_sign])  # of frame 4, towards the drive unit
    assert {name: part.link for name, part in parts.items()} == {
        **dict.fromkeys(("sleeve", "shaft", "drive"), 4),
        "wrist": 5,
        "knuckle": 6,
    }
    sleeve, shaft, drive = (parts[name] for name in ("sleeve", "shaft", "drive"))
    assert_allclose(sleeve.at_m / MM, np.outer([3, 18], back))
    assert_allclose(shaft.at_m / MM, np.outer([19, shape.shaft_length_m / MM], back))
    assert 0.9 * shape.shaft_radius_m < sleeve.size_m[0] < shape.shaft_radius_m == shaft.size_m[0]
    front_m = drive.at_m[0] - 0.5 * drive.size_m[2] * back
    assert_allclose(front_m, shape.shaft_length_m * back)  # it begins where the shaft ends
    assert min(drive.size_m) > 10 * shape.shaft_radius_m and max(drive.size_m) < 0.1

    knuckle, wrist = parts["knuckle"], parts["wrist"]
    assert knuckle.size_m == (shape.knuckle_radius_m,) and wrist.size_m == (shape.wrist_radius_m,)
    assert_allclose(knuckle.at_m, np.outer([0.45, -0.45], [0, 0, shape.finger_width_m]))
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper)
    poses = frames(arm, q)
    pitch, yaw = poses[5].translation_m, poses[6].translation_m
    assert_allclose(poses[5].apply(wrist.at_m), [pitch, pitch + 0.75 * (yaw - pitch)], atol=1e-12)
    assert {part.shape for part in (sleeve, shaft, knuckle)} == {"cylinder"}


def test_metal_is_grey_and_carbon_nearly_black():
    for rgb in (STEEL, HOUSING, CARBON):
        assert np.ptp(rgb) < 0.06 and max(rgb) < 1.0
    assert max(CARBON) < 0.2 and min(*STEEL, *HOUSING) > 0.5
