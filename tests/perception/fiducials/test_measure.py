"""Base and joints from the spheres' centres of a whole collection, robust to some wrong ones."""

import numpy as np
import pytest

from trocar.arms import ARMS
from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.fiducials.fixture import SIX_SPHERES
from trocar.perception.fiducials.measure import (
    GOOD,
    NO_JAW,
    NO_SHAFT,
    NOTHING,
    distance_errors_m,
    measure,
    register_base,
    without_wrong_distances,
)

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
    found = measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    off = T_CAMERA_BASE.inverse() @ found.hand_eye.T_camera_base
    assert np.linalg.norm(off.translation_m) < 0.05e-3
    assert np.abs(off.rotation.matrix - np.eye(3)).max() < 3e-4
    assert found.hand_eye.rejected == len(wrong_shaft)
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
    found = measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    assert [found.flags[row] for row in (9, 10, 11, 12, 13)] == [GOOD, NOTHING, NO_SHAFT, NO_JAW, NO_JAW]
    assert found.counts() == {GOOD: 196, NOTHING: 1, NO_SHAFT: 1, NO_JAW: 2}
    np.testing.assert_allclose(found.q[found.valid], q[found.valid], atol=1e-9)


def test_a_shaft_that_is_hardly_seen_gives_no_base():
    q_cmd, _, p = seen(np.random.default_rng(5))
    p[6:, :2] = np.nan
    with pytest.raises(TrocarError, match="seen in 6 images; the base needs 10"):
        measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))


def test_distances_are_told_within_the_shaft_and_within_the_jaw():
    p = SIX_SPHERES.base_centers_m(PSM, np.random.default_rng(6).uniform(PSM1_BOX.lower, PSM1_BOX.upper, (5, 6)))
    errors = distance_errors_m(SIX_SPHERES, p)
    assert errors.shape == (5, 1 + 6)
    assert np.abs(errors).max() < 1e-12


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
    found = measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    assert np.isfinite(found.p_camera_m[5, 1]).all() == kept
    assert np.isfinite(np.delete(found.p_camera_m, 5, axis=0)).all()
    assert found.hand_eye.used + found.hand_eye.rejected == 80


@pytest.mark.parametrize(("rows", "enough"), [(10, True), (9, False)])
def test_ten_rows_with_a_sphere_of_the_shaft_give_the_base(rows, enough):
    q_cmd, _, p = seen(np.random.default_rng(9), 0.0, 60)
    p[::2, 0] = p[1::2, 1] = np.nan  # one of both is enough
    p[6 * np.arange(60) >= 6 * rows, :2, 1] = np.nan  # a centre without its height is none
    if not enough:
        with pytest.raises(TrocarError, match=f"seen in {rows} images; the base needs 10 or more"):
            register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
        return
    found = register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    np.testing.assert_allclose(found.T_camera_base.matrix, T_CAMERA_BASE.matrix, atol=1e-9)
    assert (found.used, found.rejected) == (rows, 0) and found.rms_m < 1e-9


def test_a_base_says_how_well_the_centres_agree():
    q_cmd, _, p = seen(np.random.default_rng(10), 0.1e-3)
    found = register_base(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    assert found.rms_m == pytest.approx(np.sqrt(3.0) * 0.1e-3, rel=0.1)


def test_distances_are_measured_less_printed():
    """All is seen 1 % too large, but for a sphere that was not seen."""
    p = 1.01 * SIX_SPHERES.base_centers_m(PSM, PATH[:3])
    p[1, 0] = np.nan
    errors = distance_errors_m(SIX_SPHERES, p)
    neighbours, opposite = 0.035e-2 * np.sqrt(2.0), 0.07e-2
    assert errors[0, 0] == pytest.approx(0.035e-2) and np.isnan(errors[1, 0])
    np.testing.assert_allclose(np.sort(errors[:, 1:], axis=1), np.tile([neighbours] * 4 + [opposite] * 2, (3, 1)))


def test_the_rms_of_the_distances_counts_large_ones_more():
    q_cmd, _, p = seen(np.random.default_rng(11), 0.0, 40)
    p[::2, 0] += T_CAMERA_BASE.rotation.apply([0.0, 0.0, 0.4e-3])
    found = measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    errors = distance_errors_m(SIX_SPHERES, p)
    assert found.distance_rms_m == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert found.distance_rms_m > 0.05e-3


def test_where_no_distance_is_known_its_rms_is_not_either():
    q_cmd, _, p = seen(np.random.default_rng(12), 0.0, 40)
    p[:, 1:] = np.nan
    found = measure(PSM, SIX_SPHERES, p, q_cmd, np.random.default_rng(0))
    assert np.isnan(found.distance_rms_m)
    assert set(found.flags) == {NO_JAW} and not found.valid.any()
