"""Distances to an instrument's solids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, RAVEN2_LEFT, frames
from trocar.perception.instrument_solids import Capsule, Cylinder, Hull, InstrumentSolids

PSM = PSM_CLASSIC, np.array([0.1, 0.2, 0.15, 0.5, 0.4, -0.3])
RAVEN = RAVEN2_LEFT, RAVEN2_LEFT.middle + [0.0, 0.0, 0.0, 0.4, 0.3, -0.2]


TUBE = Cylinder(2.0, -1.0, 5.0)
ROD = Capsule(np.array([0.0, 3.0, 4.0]), 1.0)
BOX = Hull(np.vstack([np.eye(3), -np.eye(3)]), np.array([-1.0, -2.0, -3.0, -1.0, -2.0, -3.0]))
"""|x| <= 1, |y| <= 2, |z| <= 3"""


@pytest.mark.parametrize(
    ("solid", "p", "distance", "gradient"),
    [
        (TUBE, (3.0, 4.0, 2.0), 3.0, (0.6, 0.8, 0.0)),  # beside it
        (TUBE, (0.0, 1.0, 6.5), 1.5, (0.0, 0.0, 1.0)),  # beyond its ends
        (TUBE, (0.5, 0.0, -1.25), 0.25, (0.0, 0.0, -1.0)),
        (TUBE, (0.0, -5.0, 9.0), 5.0, (0.0, -0.6, 0.8)),  # off an edge
        (TUBE, (5.0, 0.0, -5.0), 5.0, (0.6, 0.0, -0.8)),
        (TUBE, (0.0, 1.75, 1.0), -0.25, (0.0, 1.0, 0.0)),  # within, near the side
        (TUBE, (0.0, 0.5, 4.875), -0.125, (0.0, 0.0, 1.0)),  # within, near an end
        (TUBE, (0.5, 0.0, -0.75), -0.25, (0.0, 0.0, -1.0)),
        (ROD, (2.0, 1.5, 2.0), 1.0, (1.0, 0.0, 0.0)),  # beside its middle
        (ROD, (0.0, 0.0, -3.0), 2.0, (0.0, 0.0, -1.0)),  # beyond the origin
        (ROD, (0.0, 6.0, 8.0), 4.0, (0.0, 0.6, 0.8)),  # beyond its end
        (ROD, (0.25, 1.5, 2.0), -0.75, (1.0, 0.0, 0.0)),
        (BOX, (1.5, 0.0, 1.0), 0.5, (1.0, 0.0, 0.0)),
        (BOX, (0.0, -1.5, 2.0), -0.5, (0.0, -1.0, 0.0)),
        (BOX, (0.9, 0.0, -3.5), 0.5, (0.0, 0.0, -1.0)),
    ],
)
def test_distances_and_gradients_by_hand(solid, p, distance, gradient):
    points = np.array([p, (50.0, 0.0, 0.0)])
    assert solid.distance_m(points)[0] == pytest.approx(distance, abs=1e-12)
    assert_allclose(solid.gradient(points)[0], gradient, atol=1e-12)


def test_on_the_surface_the_gradient_still_points_outward():
    assert_allclose(TUBE.gradient(np.array([[2.0, 0.0, 1.0], [0.5, 0.0, 5.0]])), [[1, 0, 0], [0, 0, 1]], atol=1e-12)


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
def test_each_part_is_where_and_as_large_as_the_instrument_says(arm, q):
    """Points 1 mm outside each part, in the frame that carries it; ``back`` leads up the shaft."""
    shape, solids, back = arm.instrument, InstrumentSolids.of(arm, q, 0.8), arm.wrist_sign
    wrist, pitch, yaw = frames(arm, q)[4], frames(arm, q)[5], frames(arm, q)[6]
    shaft, sleeve, clevis, knuckle, *_ = solids.solids
    thick, thin = shape.shaft_radius_m, 0.95 * shape.shaft_radius_m

    def distances(solid, *points):
        return solid.distance_m(np.array(points))

    beside = [[thick + 1e-3, 0.0, back * z] for z in (0.02, 0.1, shape.shaft_length_m - 1e-3)]
    ends = [[0.0, 0.0, back * (18e-3 - 1e-3)], [0.0, 0.0, back * (shape.shaft_length_m + 1e-3)]]
    assert_allclose(distances(shaft, *beside, *ends), 1e-3, atol=1e-12)
    beside = [[0.0, -thin - 1e-3, back * z] for z in (4e-3, 10e-3, 17e-3)]
    ends = [[0.0, 0.0, back * 2e-3], [0.0, 0.0, back * 19e-3]]
    assert_allclose(distances(sleeve, *beside, *ends), 1e-3, atol=1e-12)
    link = pitch.inverse().apply(yaw.translation_m)
    ahead, side = link / np.linalg.norm(link), np.cross(link, [0.0, 0.0, 1.0]) / np.linalg.norm(link)
    out = shape.wrist_radius_m + 1e-3
    assert_allclose(
        distances(clevis, -out * ahead, 0.75 * link + out * ahead, 0.4 * link + out * side), 1e-3, atol=1e-9
    )
    half = 0.45 * shape.finger_width_m
    points = [[shape.knuckle_radius_m + 1e-3, 0.0, 0.0], [0.0, 0.0, half + 1e-3], [0.0, 0.0, -half - 1e-3]]
    assert_allclose(distances(knuckle, *points), 1e-3, atol=1e-12)
    placed = [wrist.apply([0.0, thick, back * 0.1]), wrist.apply([thin, 0.0, back * 0.01])]
    assert_allclose(solids.distance_m(np.array(placed)), 0.0, atol=1e-9)


@pytest.mark.parametrize(("arm", "q"), [PSM, RAVEN])
def test_closed_fingers_touch_and_lie_on_both_sides_of_the_jaws_middle(arm, q):
    shape = arm.instrument
    *_, left, right = InstrumentSolids.of(arm, q, 0.0).solids
    ahead, half = 0.5 * shape.finger_length_m, 0.5 * shape.finger_width_m
    thick = shape.finger_thickness_m(ahead)
    points = np.array(
        [[0.2e-3, ahead, 0.0], [-0.2e-3, ahead, 0.0], [0.0, ahead, half + 1e-3], [0.0, ahead, -half - 1e-3]]
    )
    for finger, side in ((left, -1.0), (right, 1.0)):
        own, other, *edges = finger.distance_m(points * [side, 1.0, 1.0])
        assert own == pytest.approx(-0.2e-3, abs=1e-9) and other == pytest.approx(0.2e-3, abs=1e-9)
        assert_allclose(edges, 1e-3, atol=1e-9)
        outside = finger.distance_m(np.array([[side * (thick + 1e-3), ahead, 0.0]]))
        assert outside == pytest.approx(1e-3, rel=0.02)


@pytest.mark.parametrize(("arm", "q"), [PSM, RAVEN])
def test_open_fingers_are_turned_by_half_the_opening_each(arm, q):
    shape, jaw_rad = arm.instrument, 0.8
    *_, left, right = InstrumentSolids.of(arm, q, jaw_rad).solids
    for finger, angle in ((left, 0.5 * (np.pi + jaw_rad)), (right, 0.5 * (np.pi - jaw_rad))):
        inner = 0.5 * shape.finger_length_m * np.array([[np.cos(angle), np.sin(angle), 0.0]])
        assert finger.distance_m(inner) == pytest.approx(0.0, abs=1e-9)


def test_a_shaft_does_not_move_with_the_wrist():
    arm, q = PSM
    points = frames(arm, q)[4].apply([[5e-3, 1e-3, arm.wrist_sign * 0.1], [5e-3, 1e-3, arm.wrist_sign * 0.01]])
    distance, slopes = InstrumentSolids.of(arm, q, 0.5).slopes(points)
    assert (distance > 0.0).all()
    assert_allclose(slopes[:, :3], 0.0, atol=1e-9)
    assert_allclose(np.linalg.norm(slopes[:, 3:], axis=1), 1.0)


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
