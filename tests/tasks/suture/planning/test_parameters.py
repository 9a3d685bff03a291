"""Numbers of a setup by name: what was set is read back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.planning import PRESETS, Circle, SutureSetup, suture_joints
from trocar.tasks.suture.planning.parameters import SAID, SEARCHED, parameters_of, with_parameters


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


@pytest.mark.parametrize("shift_m", [{"x": 0.004, "y": -0.003}, {"x": 0.004}, {"y": -0.003}, {"z": 0.002, "x": 0.01}])
def test_a_shift_of_the_centre_is_along_the_circles_own_axes_and_leaves_the_base_where_it_is(shift_m):
    at = SE3.from_parts(SO3.exp([0.2, -0.1, 0.5]), [0.01, 0.02, -0.01])
    setup = replace(PRESETS["default"].setup, circle=Circle(T_world_circle=at))
    moved = with_parameters(setup, {f"center_{axis}_m": value for axis, value in shift_m.items()})
    np.testing.assert_allclose(moved.T_world_base.matrix, setup.T_world_base.matrix, atol=1e-12)
    shifted = at.apply([shift_m.get(axis, 0.0) for axis in "xyz"])
    np.testing.assert_allclose(moved.circle.T_world_circle.translation_m, shifted, atol=1e-15)


def test_an_unknown_parameter_is_told_with_the_choices():
    with pytest.raises(TrocarError, match=r"parameter of a setup 'radius' is unknown.*circle_radius_m"):
        with_parameters(SutureSetup(), {"radius": 0.03})


@pytest.mark.parametrize("value", [0.51, -0.51, np.nan])
def test_the_centre_is_not_shifted_out_of_the_room(value):
    with pytest.raises(TrocarError, match=r"shift of the circle's centre is .* mm; give -500 to 500 mm"):
        with_parameters(SutureSetup(), {"center_y_m": value})


def test_on_the_command_line_names_end_in_their_units():
    assert SAID["base_tilt_deg"] == "base_tilt_rad" and SAID["center_z_mm"] == "center_z_m"
    assert SAID["regrasp_deg"] == "insertion_regrasp_rad"
