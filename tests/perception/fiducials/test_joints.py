"""Joints from the spheres' centres: exact on perfect ones."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.perception.fiducials.fixture import SIX_SPHERES
from trocar.perception.fiducials.joints import is_psm, joints_from_spheres, shaft_joints, wrist_joints

PSMS = [name for name, arm in ARMS.items() if is_psm(arm)]
PSM = ARMS["psm-classic"]
JAW_SPHERES = np.flatnonzero(~SIX_SPHERES.on_shaft)


def anywhere(arm, rng, count=100):
    """Return configurations (n, 6) all over an arm's ranges, the wrist below the remote centre."""
    lower, upper = arm.lower.copy(), arm.upper.copy()
    lower[2] = 0.1
    return rng.uniform(lower, upper, (count, 6))


def test_all_psms_and_no_ravens_are_psms():
    assert PSMS == ["psm-classic", "psm-si"]


def test_an_arm_is_a_psm_by_its_first_three_axes():
    """Their twists, and where yaw and pitch begin; how far the shaft goes in says nothing."""
    turned = replace(PSM, twists_rad=tuple(-twist for twist in PSM.twists_rad))
    started = replace(PSM, offsets=(PSM.offsets[0], -PSM.offsets[1], *PSM.offsets[2:]))
    longer = replace(PSM, offsets=(*PSM.offsets[:2], PSM.offsets[2] + 0.01, *PSM.offsets[3:]))
    assert [is_psm(arm) for arm in (PSM, turned, started, longer)] == [True, False, False, True]


@pytest.mark.parametrize("name", PSMS)
def test_perfect_centres_give_the_joints_exactly(name):
    arm = ARMS[name]
    q = anywhere(arm, np.random.default_rng(0))
    p = SIX_SPHERES.base_centers_m(arm, q)
    found = joints_from_spheres(arm, SIX_SPHERES, p, q + [0, 0, 0, 0.5, 0, 0])
    np.testing.assert_allclose(found, q, atol=1e-12)


def test_one_sphere_of_the_shaft_and_three_of_the_jaw_are_enough_and_fewer_are_not():
    q = anywhere(PSM, np.random.default_rng(1), 20)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    p[:, 0] = p[:, JAW_SPHERES[2]] = np.nan
    np.testing.assert_allclose(joints_from_spheres(PSM, SIX_SPHERES, p, q), q, atol=1e-12)
    p[3, JAW_SPHERES[0]] = np.nan
    p[4, 1] = np.nan
    found = joints_from_spheres(PSM, SIX_SPHERES, p, q)
    assert np.isfinite(found[3, :3]).all() and np.isnan(found[3, 3:]).all()
    assert np.isnan(found[4]).all()
    assert np.isfinite(found[5:]).all()


def test_an_arm_that_is_no_psm_is_refused():
    raven = ARMS["raven2-left"]
    with pytest.raises(TrocarError, match="on a PSM only, not on 'raven2-left'"):
        joints_from_spheres(raven, SIX_SPHERES, np.zeros((1, 6, 3)), np.zeros((1, 6)))


@pytest.mark.parametrize("turns", [-2, -1, 0, 1])
def test_commands_tell_in_which_turn_the_roll_is(turns):
    """Also if they are off by almost half a turn."""
    q = anywhere(PSM, np.random.default_rng(2), 20)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    q[:, 3] += 2.0 * np.pi * turns
    for off in (-3.0, 3.0):
        found = joints_from_spheres(PSM, SIX_SPHERES, p, q + [0, 0, 0, off, 0, 0])
        np.testing.assert_allclose(found, q, atol=1e-12)


def test_the_commands_of_the_other_joints_do_not_matter():
    q = anywhere(PSM, np.random.default_rng(2), 20)
    found = joints_from_spheres(PSM, SIX_SPHERES, SIX_SPHERES.base_centers_m(PSM, q), q + [1, -1, 0.1, 0, 1, -1])
    np.testing.assert_allclose(found, q, atol=1e-12)


def test_the_farther_sphere_of_the_shaft_weighs_more():
    """Spheres that are off across the shaft by the same angle on either side: the farther one gets its share more."""
    q = np.zeros((1, 6))
    q[0, 2] = 0.15
    p = SIX_SPHERES.base_centers_m(PSM, q)[:, :2]
    distance = np.linalg.norm(p, axis=-1)[0]
    across = 1e-3 * np.array([1.0, 0.0, 0.0])
    both = SIX_SPHERES.base_centers_m(PSM, q)
    both[0, 0] += distance[0] * across
    both[0, 1] -= distance[1] * across
    found = shaft_joints(PSM, SIX_SPHERES, both)[0]
    expected = 1e-3 * (distance[0] ** 2 - distance[1] ** 2) / (distance**2).sum()
    assert found[0] == pytest.approx(expected, rel=1e-3) and found[1] == pytest.approx(0.0, abs=1e-12)


def test_the_insertion_is_the_mean_of_what_the_spheres_of_the_shaft_say():
    q = anywhere(PSM, np.random.default_rng(3), 5)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    p[:, 0] *= 1.0 + 1e-3 / np.linalg.norm(p[:, 0], axis=-1, keepdims=True)
    found = shaft_joints(PSM, SIX_SPHERES, p)
    np.testing.assert_allclose(found - q[:, :3], np.tile([0.0, 0.0, 0.5e-3], (5, 1)), atol=1e-9)
    p[:, 1] = np.nan
    np.testing.assert_allclose(shaft_joints(PSM, SIX_SPHERES, p)[:, 2] - q[:, 2], 1e-3, atol=1e-9)


def test_each_function_refuses_an_arm_that_is_no_psm():
    raven = ARMS["raven2-left"]
    with pytest.raises(TrocarError, match="give its recording"):
        shaft_joints(raven, SIX_SPHERES, np.zeros((1, 6, 3)))
    with pytest.raises(TrocarError, match="give its recording"):
        wrist_joints(raven, np.eye(3)[None], np.zeros((1, 3)), 0.0)


def test_the_wrists_joints_count_from_where_the_arm_says():
    arm = replace(PSM, offsets=(*PSM.offsets[:3], 0.3, -0.2, 0.1))
    q = anywhere(arm, np.random.default_rng(4), 20)
    found = joints_from_spheres(arm, SIX_SPHERES, SIX_SPHERES.base_centers_m(arm, q), q)
    np.testing.assert_allclose(found, q, atol=1e-12)


def test_a_centre_of_which_a_coordinate_is_missing_is_none():
    q = anywhere(PSM, np.random.default_rng(5), 8)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    p[0, 0, 2] = p[1, 1, 0] = p[2, 2, 1] = np.nan
    np.testing.assert_allclose(joints_from_spheres(PSM, SIX_SPHERES, p, q), q, atol=1e-12)
    p[0, 1, 1] = np.nan
    assert np.isnan(joints_from_spheres(PSM, SIX_SPHERES, p, q)[0]).all()
