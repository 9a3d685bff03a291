import math

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import Circle, Insertion, Needle, NeedleGrasp, SutureSetup, base_beside


def test_the_instrument_of_a_tilted_base_points_at_the_origin():
    tilt = math.atan2(0.05, 0.1)
    T = base_beside(math.radians(225), 0.05, 0.1, tilt_rad=tilt, spin_rad=1.0)
    along = -T.matrix[:3, 2]
    np.testing.assert_allclose(T.translation_m + along * math.hypot(0.05, 0.1), 0.0, atol=1e-15)


def test_without_skew_the_wire_lies_where_the_fingers_meet():
    for lean in (-0.4, 0.0, 0.7):
        for approach in (-1.0, 0.3):
            grasp = NeedleGrasp(approach_rad=approach, lean_rad=lean)
            assert grasp.out_of_jaws_rad == pytest.approx(0.0, abs=1e-12)
            assert grasp.holdable
    skewed = NeedleGrasp(approach_rad=0.3, skew_rad=math.radians(20))
    assert math.degrees(skewed.out_of_jaws_rad) == pytest.approx(20.0)
    assert not skewed.holdable


def test_the_jaws_of_a_plain_grasp_point_at_the_needles_centre():
    closing, axis, back = NeedleGrasp().rotation.matrix.T
    np.testing.assert_allclose(back, [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(axis, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(closing, [0, 0, -1], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: SutureSetup(needle=Needle(radius_m=0.02)), "radius up to 15.0 mm or a larger circle"),
        (lambda: SutureSetup(needle=Needle(arc_rad=math.pi)), "beyond its tail at 180 deg"),
        (lambda: Circle(radius_m=-0.01), "circle radius is -10 mm; give 2 to 200 mm"),
        (lambda: Needle(radius_m=math.nan), "needle radius is nan mm"),
        (lambda: Insertion(entry_angle_rad=2.0), "entry angle is 114.592 deg; give 0 to 90 deg"),
        (lambda: Insertion(theta_is="exit"), "choose one of entry, middle"),
        (lambda: Insertion(pushes=-1), "give 0 to 10"),
        (lambda: NeedleGrasp(skew_rad=10.0), "grasp skew"),
        (lambda: base_beside(0.0, 2.0, 0.1), "base sideways is 2000 mm"),
    ],
)
def test_bad_values_are_named(make, says):
    with pytest.raises(TrocarError, match=says):
        make()
