"""The shapes of instruments: corners and thickness by hand, and what every real one must be."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, LARGE_NEEDLE_DRIVER, RAVEN_GRIPPER, FingerMarks, Instrument
from trocar.arms.instrument import CLEVIS_SHARE, KNUCKLE_SHARE, SLEEVE_M, SLEEVE_SHARE
from trocar.errors import TrocarError

MM = 1e-3
PLAIN = Instrument("plain", 4 * MM, 0.4, 3 * MM, 3 * MM, 10 * MM, 2 * MM, 1 * MM, 3 * MM, 1 * MM)
"""Fingers of 10 mm, 2 mm thick at the axis, 1 mm at the end, 3 mm wide, rounded off over 1 mm."""
REAL = pytest.mark.parametrize("shape", [LARGE_NEEDLE_DRIVER, RAVEN_GRIPPER], ids=lambda shape: shape.name)
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@pytest.mark.parametrize("side", [1, -1])
def test_the_corners_of_a_finger_by_hand(side):
    profile = [(0, 0), (9.7, 0), (10, 0.3), (9, 1), (0, 2)]
    expected = [(x, side * y, z) for x, y in profile for z in (-1.5, 1.5)]
    assert_allclose(PLAIN.finger_m(side) / MM, expected, atol=1e-12)


@pytest.mark.parametrize(("from_end_mm", "thick_mm"), [(0, 1), (1, 1), (5.5, 1.5), (7.75, 1.75), (10, 2)])
def test_a_finger_is_thicker_the_further_back(from_end_mm, thick_mm):
    assert PLAIN.finger_thickness_m(from_end_mm * MM) == pytest.approx(thick_mm * MM)


@pytest.mark.parametrize("shape", [PLAIN, LARGE_NEEDLE_DRIVER, RAVEN_GRIPPER], ids=lambda shape: shape.name)
def test_the_capsule_along_a_finger_holds_it_and_is_no_wider_than_it_must_be(shape):
    corners = shape.finger_m(1)
    off_axis = np.hypot(corners[:, 1], corners[:, 2])
    assert shape.finger_radius_m == pytest.approx(off_axis.max())


def test_marks_lie_behind_the_closing_plane_and_turn_with_their_finger():
    marks = FingerMarks((RED, BLUE), along_m=(3 * MM, 7 * MM), behind_m=2 * MM)
    assert_allclose(marks.centers_m(1, 0.0) / MM, [(3, 2, 0), (7, 2, 0)])
    assert_allclose(marks.centers_m(-1, 0.0) / MM, [(3, -2, 0), (7, -2, 0)])
    assert_allclose(marks.centers_m(1, np.pi) / MM, [(-2, 3, 0), (-2, 7, 0)], atol=1e-12)  # by a right angle
    left, right = (marks.centers_m(side, 0.7) for side in (1, -1))
    assert_allclose(right, left * [1, -1, 1])
    assert_allclose(np.linalg.norm(left, axis=1) / MM, np.sqrt([13, 53]))
    with pytest.raises(TrocarError, match="behind_m"):
        FingerMarks((RED, BLUE), behind_m=np.nan)


@pytest.mark.parametrize("arm", [arm for arm in ARMS.values() if arm.instrument.marks], ids=lambda arm: arm.name)
def test_marks_are_seen_apart_on_the_finger_from_behind_and_from_both_sides(arm):
    shape, marks = arm.instrument, arm.instrument.marks
    near, far = marks.centers_m(1, 0.0)
    assert near[0] - marks.radius_m > shape.knuckle_radius_m > 0, "the knuckle hides none"
    assert near[0] + marks.radius_m < far[0] - marks.radius_m, "they do not touch"
    assert far[0] + marks.radius_m < shape.finger_length_m
    for center in (near, far):
        thick = shape.finger_thickness_m(shape.finger_length_m - center[0])
        assert center[1] - marks.radius_m > 0, "none reaches the other finger's side"
        assert thick < center[1] + marks.radius_m < thick + 2 * marks.radius_m, "they stand out from the back"
    assert 0 < marks.proud_m < 0.15 * shape.finger_width_m


@REAL
def test_an_instrument_passes_through_a_trocar_for_its_shaft(shape):
    assert shape.shaft_radius_m == 4 * MM, "both are 8 mm instruments"
    assert max(shape.wrist_radius_m, shape.knuckle_radius_m, shape.finger_radius_m) < shape.shaft_radius_m
    assert shape.finger_tip_m < shape.finger_base_m < shape.knuckle_radius_m, "closed fingers leave the knuckle free"
    assert shape.finger_width_m < 2 * shape.knuckle_radius_m
    assert shape.tip_chamfer_m < 1.5 * shape.finger_tip_m, "its end is round, not a wedge"


@REAL
def test_steel_and_knuckle_are_within_what_they_are_parts_of(shape):
    assert 0.5 < SLEEVE_SHARE < 1 and 0.5 < KNUCKLE_SHARE < 1 and 0.5 < CLEVIS_SHARE < 1
    start, end = SLEEVE_M
    assert abs(start - shape.wrist_radius_m) < 0.5 * MM, "the sleeve begins where the wrist's clevis ends"
    assert 2 * shape.shaft_radius_m < end - start < 4 * shape.shaft_radius_m


def test_lengths_are_as_measured():
    """The jaws' ends beyond their axis, and the Raven's shaft (d4)."""
    assert LARGE_NEEDLE_DRIVER.finger_length_m == 0.0102
    assert (RAVEN_GRIPPER.finger_length_m, RAVEN_GRIPPER.shaft_length_m) == (0.020, 0.470)
    psm, raven = ARMS["psm-classic"], ARMS["raven2-left"]
    for arm in (psm, raven):
        assert 0 < arm.tip_length_m < arm.instrument.finger_length_m, "the controlled point is between the jaws"
        deepest = arm.safe_depth_m + float(np.ptp([arm.joints[2].lower, arm.joints[2].upper]))
        assert deepest < arm.instrument.shaft_length_m < 2 * deepest, "the shaft reaches in, with room for the drive"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"finger_tip_m": -MM}, "finger_tip_m"),
        ({"wrist_radius_m": 0.0}, "wrist_radius_m of instrument .* is 0.0; give a length above 0"),
        ({"finger_width_m": np.nan}, "must be finite"),
        ({"tip_chamfer_m": 10 * MM}, "give a shorter one"),
    ],
)
def test_shapes_that_cannot_be_are_refused(change, says):
    with pytest.raises(TrocarError, match=says):
        replace(PLAIN, **change)
