"""Joints and base from the spheres' centres: exact on perfect ones, robust to some wrong ones."""

import numpy as np
import pytest

from trocar.arms import ARMS
from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.fiducials.fixture import JAW, SIX_SPHERES, Fixture, Sphere
from trocar.perception.fiducials.joints import is_psm, joints_from_spheres
from trocar.perception.fiducials.measure import GOOD, NO_JAW, NO_SHAFT, NOTHING, distance_errors_m, measure

PSMS = [name for name, arm in ARMS.items() if is_psm(arm)]
PSM = ARMS["psm-classic"]
JAW_SPHERES = np.flatnonzero(~SIX_SPHERES.on_shaft)


def anywhere(arm, rng, count=500):
    """Return configurations (n, 6) all over an arm's ranges, the wrist below the remote centre."""
    lower, upper = arm.lower.copy(), arm.upper.copy()
    lower[2] = 0.1
    return rng.uniform(lower, upper, (count, 6))


def test_all_psms_and_no_ravens_are_psms():
    assert PSMS == ["psm-classic", "psm-si"]


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


def test_the_printed_distances_are_those_of_the_paper():
    shaft = np.linalg.norm(SIX_SPHERES.centers_m[0] - SIX_SPHERES.centers_m[1])
    assert shaft == pytest.approx(0.035)
    assert SIX_SPHERES.centers_m[1, 2] == pytest.approx(0.0158)
    hub = np.array(SIX_SPHERES.hub_m)
    np.testing.assert_allclose(np.linalg.norm(SIX_SPHERES.centers_m[JAW_SPHERES] - hub, axis=-1), 0.035)
    np.testing.assert_allclose(2e3 * SIX_SPHERES.radii_m, [20, 17, 16, 16, 16, 16])


@pytest.mark.parametrize(
    ("spheres", "words"),
    [
        ((), "0 spheres on the shaft"),
        (SIX_SPHERES.spheres[:4], "2 spheres on the jaw; give 3"),
        ((*SIX_SPHERES.spheres, Sphere(JAW, "mauve", 0.008, (0, 0, 0))), "colour is 'mauve'; choose one of red, green"),
    ],
)
def test_an_impossible_fixture_is_refused(spheres, words):
    with pytest.raises(TrocarError, match=words):
        Fixture(spheres, (0.0, 0.0, 0.0))


# A whole collection of centres.

T_CAMERA_BASE = SE3.from_parts(SO3.axis("x", 2.5) @ SO3.axis("z", 0.3), (0.1, -0.05, 0.45))


def seen(rng, sd_m=0.05e-3, count=200):
    """Return commands, true joints and noisy centres in the camera."""
    q_cmd = random_smooth_path(PSM, rng, box=PSM1_BOX)[:count]
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
    p = SIX_SPHERES.base_centers_m(PSM, anywhere(PSM, np.random.default_rng(6), 5))
    errors = distance_errors_m(SIX_SPHERES, p)
    assert errors.shape == (5, 1 + 6)
    assert np.abs(errors).max() < 1e-12
