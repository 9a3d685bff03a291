import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.planning import (
    PRESETS,
    Circle,
    Insertion,
    Needle,
    NeedleGrasp,
    SutureSetup,
    base_beside,
    suture_joints,
)
from trocar.tasks.suture.planning.setup import SEARCHED, parameters_of, with_parameters


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


# Its numbers by name.


def drawn(seed):
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(*ends) for name, ends in SEARCHED.items() if not name.startswith("center")}


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_was_set_is_read_back_and_sets_the_same_again(seed):
    values = drawn(seed)
    setup = with_parameters(SutureSetup(), values)
    found = parameters_of(setup)
    for name, value in values.items():
        assert found[name] == pytest.approx(value, abs=1e-9), name
    again = with_parameters(setup, found)
    np.testing.assert_allclose(again.T_world_base.matrix, setup.T_world_base.matrix, atol=1e-12)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), twist=st.tuples(*[st.floats(-0.3, 0.3)] * 6))
def test_a_setup_in_any_pose_is_kept_by_its_own_numbers(seed, twist):
    setup = with_parameters(SutureSetup(), drawn(seed))
    moved = replace(setup, T_world_base=setup.T_world_base @ SE3.exp(twist))
    again = with_parameters(moved, parameters_of(moved))
    np.testing.assert_allclose(again.T_world_base.matrix, moved.T_world_base.matrix, atol=1e-9)


def test_another_azimuth_rotates_the_joints_round_the_circle():
    setup = PRESETS["default"].setup
    at = parameters_of(setup)["base_azimuth_rad"]
    turned = with_parameters(setup, {"base_azimuth_rad": at + np.radians(40)})
    thetas = np.radians(np.arange(0, 360, 20))
    np.testing.assert_allclose(
        suture_joints(turned, thetas).q, suture_joints(setup, thetas - np.radians(40)).q, atol=1e-9
    )


@pytest.mark.parametrize("shift_m", [{"x": 0.004, "y": -0.003}, {"x": 0.004}, {"y": -0.003}])
def test_a_shift_of_the_centre_is_along_the_circles_own_axes_and_leaves_the_base_where_it_is(shift_m):
    at = SE3.from_parts(SO3.exp([0.2, -0.1, 0.5]), [0.01, 0.02, -0.01])
    setup = replace(PRESETS["default"].setup, circle=Circle(T_world_circle=at))
    moved = with_parameters(setup, {f"center_{axis}_m": value for axis, value in shift_m.items()})
    np.testing.assert_allclose(moved.T_world_base.matrix, setup.T_world_base.matrix, atol=1e-12)
    shifted = at.apply([shift_m.get("x", 0.0), shift_m.get("y", 0.0), 0.0])
    np.testing.assert_allclose(moved.circle.T_world_circle.translation_m, shifted, atol=1e-15)


def test_an_unknown_parameter_is_told_with_the_choices():
    with pytest.raises(TrocarError, match=r"parameter of a setup 'radius' is unknown.*circle_radius_m"):
        with_parameters(SutureSetup(), {"radius": 0.03})
