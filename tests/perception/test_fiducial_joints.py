"""Base and joints from the spheres' centres of a whole collection, robust to some wrong ones."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS
from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.perception.fiducial_joints import (
    GOOD,
    NO_JAW,
    NO_SHAFT,
    NOTHING,
    distance_errors_m,
    joints_from_spheres,
    measure,
    register_base,
    require_psm,
    without_wrong_distances,
)
from trocar.perception.fiducials import SIX_SPHERES

PSM = ARMS["psm-classic"]
JAW_SPHERES = np.flatnonzero(~SIX_SPHERES.on_shaft)
T_CAMERA_BASE = SE3.from_parts(SO3.axis("x", 2.5) @ SO3.axis("z", 0.3), (0.1, -0.05, 0.45))


PATH = random_smooth_path(PSM, np.random.default_rng(3), box=PSM1_BOX)


def seen(rng, sd_m=0.05e-3, count=200):
    """Return commands, true joints and noisy centres in the camera."""
    q_cmd = PATH[:count]
    q = q_cmd + [0, 0, 0, 0.25, -0.1, 0.12]
    p = T_CAMERA_BASE.apply(SIX_SPHERES.base_centers_m(PSM, q))
    return q_cmd, q, p + sd_m * rng.standard_normal(p.shape)


def test_base_and_joints_are_found_though_the_cables_are_off_and_some_spheres_are_wrong():
    rng = np.random.default_rng(3)
    q_cmd, q, p = seen(rng)
    wrong_shaft, wrong_jaw = np.arange(0, 200, 9), np.arange(4, 200, 9)
    p[wrong_shaft, 0] += rng.uniform(0.005, 0.03, (len(wrong_shaft), 3))
    p[wrong_jaw, JAW_SPHERES[1]] += 0.004
    found = measure(PSM, SIX_SPHERES, p, q_cmd, T_CAMERA_BASE, np.random.default_rng(0))
    off = T_CAMERA_BASE.inverse() @ found.T_camera_base
    assert np.linalg.norm(off.translation_m) < 0.1e-3  # from the images alone, without encoders
    assert np.abs(off.rotation.matrix - np.eye(3)).max() < 3e-4
    assert (~found.shaft.inliers).sum() == len(wrong_shaft)
    assert found.valid.all()
    error = np.sqrt(np.mean((found.q - q) ** 2, axis=0))
    assert error[[0, 1]].max() < 1e-3 and error[2] < 0.1e-3 and error[3:].max() < 3e-3
    assert np.isnan(found.p_camera_m[wrong_jaw, JAW_SPHERES[1]]).all()
    assert np.isnan(found.p_camera_m[wrong_shaft, 0]).all()
    assert found.distance_rms_m < 0.1e-3


def test_rows_without_enough_spheres_are_flagged_and_the_others_stay():
    q_cmd, q, p = seen(np.random.default_rng(4), sd_m=0.0)
    p[10] = np.nan
    p[11, :2] = np.nan
    p[12, JAW_SPHERES[:2]] = np.nan
    p[13, JAW_SPHERES[0]], p[13, JAW_SPHERES[3]] = p[13, JAW_SPHERES[3]].copy(), p[13, JAW_SPHERES[0]].copy()
    found = measure(PSM, SIX_SPHERES, p, q_cmd, T_CAMERA_BASE, np.random.default_rng(0))
    assert [found.flags[row] for row in (9, 10, 11, 12, 13)] == [GOOD, NOTHING, NO_SHAFT, NO_JAW, NO_JAW]
    assert found.counts() == {GOOD: 196, NOTHING: 1, NO_SHAFT: 1, NO_JAW: 2}
    np.testing.assert_allclose(found.q[found.valid], q[found.valid], atol=1e-9)


def moved(p, row, sphere, by_m):
    """Move a centre by so much, away from the hub of its row."""
    away = p[row, sphere] - p[row, JAW_SPHERES].mean(axis=0)
    p[row, sphere] += by_m * away / np.linalg.norm(away)


@pytest.mark.parametrize(("by_m", "dropped"), [(0.8e-3, False), (1.4e-3, True), (-1.4e-3, True)])
def test_a_sphere_of_the_jaw_at_wrong_distances_is_dropped_and_no_other(by_m, dropped):
    """Outward by 1.4 mm: 1 mm farther from its neighbours; the limit is 1 mm."""
    _, _, p = seen(np.random.default_rng(7), 0.0, 12)
    p[:, 0] += 0.05  # of the shaft: not its business
    for row in range(4):
        moved(p, row, JAW_SPHERES[row], by_m * 1.1)
    before = p.copy()
    found = without_wrong_distances(SIX_SPHERES, p)
    np.testing.assert_array_equal(p, before)
    expected = np.zeros(p.shape[:2], dtype=bool)
    expected[np.arange(4), JAW_SPHERES] = dropped
    np.testing.assert_array_equal(np.isnan(found).all(axis=-1), expected)
    np.testing.assert_array_equal(found[~expected], p[~expected])


def test_of_two_that_contradict_each_other_one_is_dropped():
    _, _, p = seen(np.random.default_rng(7), 0.0, 12)
    p[0, JAW_SPHERES[2:]] = np.nan
    moved(p, 0, JAW_SPHERES[0], 0.01)
    found = without_wrong_distances(SIX_SPHERES, p)
    assert np.isfinite(found[0, JAW_SPHERES]).all(axis=-1).sum() == 1
    p = seen(np.random.default_rng(7), 0.0, 12)[2]
    moved(p, 0, JAW_SPHERES[0], 0.01)
    moved(p, 0, JAW_SPHERES[1], 0.02)
    found = without_wrong_distances(SIX_SPHERES, p)
    assert np.isfinite(found[0, JAW_SPHERES]).all(axis=-1).tolist() == [False, False, True, True]


@pytest.mark.parametrize(("off_m", "kept"), [(0.7e-3, True), (1.3e-3, False)])
def test_a_sphere_on_the_shaft_far_from_where_encoders_put_it_is_dropped(off_m, kept):
    q_cmd, _, p = seen(np.random.default_rng(8), 0.0, 40)
    p[5, 1] += T_CAMERA_BASE.rotation.apply([off_m, 0.0, 0.0])
    found = measure(PSM, SIX_SPHERES, p, q_cmd, T_CAMERA_BASE, np.random.default_rng(0))
    assert np.isfinite(found.p_camera_m[5, 1]).all() == kept
    assert np.isfinite(np.delete(found.p_camera_m, 5, axis=0)).all()
    assert len(found.shaft.inliers) == 80


@pytest.mark.parametrize(("rows", "enough"), [(10, True), (9, False)])
def test_ten_rows_with_a_sphere_of_the_shaft_give_the_base(rows, enough):
    q_cmd, _, p = seen(np.random.default_rng(9), 0.0, 60)
    p[::2, 0] = p[1::2, 1] = np.nan  # one of both is enough
    p[6 * np.arange(60) >= 6 * rows, :2, 1] = np.nan  # a centre without its height is none
    if not enough:
        with pytest.raises(InvalidInput, match=f"seen in {rows} images; the base needs 10 or more"):
            register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
        return
    found = register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    np.testing.assert_allclose(found.T_target_source.matrix, T_CAMERA_BASE.matrix, atol=1e-9)
    assert found.inliers.all() and len(found.inliers) == rows and found.rms_m < 1e-9


def test_a_base_says_how_well_the_centres_agree():
    q_cmd, _, p = seen(np.random.default_rng(10), 0.1e-3)
    found = register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    assert found.rms_m == pytest.approx(np.sqrt(3.0) * 0.1e-3, rel=0.1)


def test_distances_are_measured_less_printed():
    """All is seen 1 % too large, but for a sphere that was not seen."""
    p = 1.01 * SIX_SPHERES.base_centers_m(PSM, PATH[:3])
    p[1, 0] = np.nan
    errors = distance_errors_m(SIX_SPHERES, p)
    assert errors.shape == (3, 1 + 6), "within the shaft and within the jaw"
    neighbours, opposite = 0.035e-2 * np.sqrt(2.0), 0.07e-2
    assert errors[0, 0] == pytest.approx(0.035e-2) and np.isnan(errors[1, 0])
    np.testing.assert_allclose(np.sort(errors[:, 1:], axis=1), np.tile([neighbours] * 4 + [opposite] * 2, (3, 1)))


def test_the_rms_of_the_distances_counts_large_ones_more():
    q_cmd, _, p = seen(np.random.default_rng(11), 0.0, 40)
    p[::2, 0] += T_CAMERA_BASE.rotation.apply([0.0, 0.0, 0.4e-3])
    found = measure(PSM, SIX_SPHERES, p, q_cmd, T_CAMERA_BASE, np.random.default_rng(0))
    errors = distance_errors_m(SIX_SPHERES, p)
    assert found.distance_rms_m == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert found.distance_rms_m > 0.05e-3


def test_where_no_distance_is_known_its_rms_is_not_either():
    q_cmd, _, p = seen(np.random.default_rng(12), 0.0, 40)
    p[:, 1:] = np.nan
    found = measure(PSM, SIX_SPHERES, p, q_cmd, T_CAMERA_BASE, np.random.default_rng(0))
    assert np.isnan(found.distance_rms_m)
    assert set(found.flags) == {NO_JAW} and not found.valid.any()


# The joints of perfect centres.


def is_psm(arm):
    try:
        require_psm(arm)
    except InvalidInput:
        return False
    return True


PSMS = [name for name, arm in ARMS.items() if is_psm(arm)]


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
    with pytest.raises(InvalidInput, match="on a PSM only, not on 'raven2-left'"):
        joints_from_spheres(raven, SIX_SPHERES, np.zeros((1, 6, 3)), np.zeros((1, 6)))


@pytest.mark.parametrize("turns", [-2, -1, 0, 1])
def test_commands_tell_in_which_turn_the_roll_is_and_nothing_else(turns):
    """Also if they are off by almost half a turn."""
    q = anywhere(PSM, np.random.default_rng(2), 20)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    q[:, 3] += 2.0 * np.pi * turns
    for off in (-3.0, 3.0):
        found = joints_from_spheres(PSM, SIX_SPHERES, p, q + [1, -1, 0.1, off, 1, -1])
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
    found = joints_from_spheres(PSM, SIX_SPHERES, both, q)[0]
    expected = 1e-3 * (distance[0] ** 2 - distance[1] ** 2) / (distance**2).sum()
    assert found[0] == pytest.approx(expected, rel=1e-3) and found[1] == pytest.approx(0.0, abs=1e-12)


def test_the_insertion_is_the_mean_of_what_the_spheres_of_the_shaft_say():
    q = anywhere(PSM, np.random.default_rng(3), 5)
    p = SIX_SPHERES.base_centers_m(PSM, q)
    p[:, 0] *= 1.0 + 1e-3 / np.linalg.norm(p[:, 0], axis=-1, keepdims=True)
    found = joints_from_spheres(PSM, SIX_SPHERES, p, q)[:, :3]
    np.testing.assert_allclose(found - q[:, :3], np.tile([0.0, 0.0, 0.5e-3], (5, 1)), atol=1e-9)
    p[:, 1] = np.nan
    np.testing.assert_allclose(joints_from_spheres(PSM, SIX_SPHERES, p, q)[:, 2] - q[:, 2], 1e-3, atol=1e-9)


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
