"""Distances to an instrument's solids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, RAVEN2_LEFT, frames
from trocar.perception.instrument.solids import InstrumentSolids

PSM = PSM_CLASSIC, np.array([0.1, 0.2, 0.15, 0.5, 0.4, -0.3])
RAVEN = RAVEN2_LEFT, RAVEN2_LEFT.middle + [0.0, 0.0, 0.0, 0.4, 0.3, -0.2]


def around(arm, q, rng, count=400):
    return frames(arm, q)[6].translation_m + rng.uniform(-0.025, 0.025, (count, 3))


@pytest.mark.parametrize(("arm", "q"), [PSM, RAVEN])
def test_known_points_are_as_far_as_they_are(arm, q):
    shape, solids = arm.instrument, InstrumentSolids.of(arm, q, 0.8)
    shaft, jaws = frames(arm, q)[4], frames(arm, q)[6]
    beside_shaft = shaft.apply([shape.shaft_radius_m + 1e-3, 0.0, arm.wrist_sign * 0.1])
    finger_end = 0.5 * np.pi + 0.4  # along y of frame 6, turned by half the opening
    beyond = jaws.apply((shape.finger_length_m + 2e-3) * np.array([np.cos(finger_end), np.sin(finger_end), 0.0]))
    inside = jaws.apply(0.5 * shape.finger_length_m * np.array([np.cos(finger_end), np.sin(finger_end), 0.0]))
    near = solids.distance_m(np.array([beside_shaft, beyond, inside]))
    assert near[0] == pytest.approx(1e-3, abs=1e-9)
    assert 1.2e-3 < near[1] <= 2e-3, "the end is rounded off"
    assert near[2] < 1e-9


@pytest.mark.parametrize(("arm", "q"), [PSM, RAVEN])
@pytest.mark.parametrize("jaw_rad", [0.0, 1.0])
def test_slopes_are_those_of_the_distances(arm, q, jaw_rad):
    points = around(arm, q, np.random.default_rng(0))
    distance, slopes = InstrumentSolids.of(arm, q, jaw_rad).slopes(points)
    assert_allclose(distance, InstrumentSolids.of(arm, q, jaw_rad).distance_m(points))
    step = 1e-6
    for column in range(6):
        both = []
        for sign in (step, -step):
            turned, shifted = q.copy(), points.copy()
            if column < 3:
                turned[3 + column] += sign
            else:
                shifted[:, column - 3] -= sign
            both.append(InstrumentSolids.of(arm, turned, jaw_rad).distance_m(shifted))
        numeric = (both[0] - both[1]) / (2 * step)
        wrong = np.abs(numeric - slopes[:, column]) > 1e-4
        assert wrong.mean() < 0.01, "but where the nearest solid changes"


def test_a_jaw_that_opens_moves_its_fingers_apart():
    arm, q = PSM
    ends = frames(arm, q)[6].apply([[0.006, 0.008, 0.0], [-0.006, 0.008, 0.0]])
    closed, open_ = (InstrumentSolids.of(arm, q, jaw_rad).distance_m(ends) for jaw_rad in (0.0, 1.2))
    assert (open_ < closed - 3e-3).all()
