from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.tasks.suture.planning import PRESETS, SutureSetup, suture_joints
from trocar.tasks.suture.planning.parameters import PARAMETERS, parameters_of, with_parameters

BOUNDS = {name: found.bounds for name, found in PARAMETERS.items() if found.bounds and found.part != "center"}


def drawn(seed):
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(*ends) for name, ends in BOUNDS.items()}


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


def test_a_shift_of_the_centre_leaves_the_base_where_it_is():
    setup = PRESETS["default"].setup
    moved = with_parameters(setup, {"center_x_m": 0.004, "center_y_m": -0.003})
    np.testing.assert_allclose(moved.T_world_base.matrix, setup.T_world_base.matrix, atol=1e-12)
    np.testing.assert_allclose(moved.circle.T_world_circle.translation_m, [0.004, -0.003, 0.0], atol=1e-15)


def test_an_unknown_parameter_is_told_with_the_choices():
    with pytest.raises(TrocarError, match=r"parameter of a setup 'radius' is unknown.*circle_radius_m"):
        with_parameters(SutureSetup(), {"radius": 0.03})
