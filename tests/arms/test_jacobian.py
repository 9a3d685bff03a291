import numpy as np
import pytest

from recounted import SHIFT, recounted
from trocar.arms import ARMS, PSM_CLASSIC, PSM_SI, fk, frames, jacobian, limit_violations, manipulability, wrist_depth_m
from trocar.errors import TrocarError

arms = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)


def sample(arm, seed, shape=()):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (*shape, 6))


@arms
def test_the_jacobian_is_the_finite_difference(arm):
    q, h = sample(arm, 5, (200,)), 1e-5
    T, J = fk(arm, q), np.empty((200, 6, 6))
    for i in range(6):
        step = h * np.eye(6)[i]
        after, before = fk(arm, q + step), fk(arm, q - step)
        J[:, :3, i] = (after.translation_m - before.translation_m) / (2 * h)
        J[:, 3:, i] = (after.rotation @ T.rotation.inverse()).log() / (2 * h)
        J[:, 3:, i] -= (before.rotation @ T.rotation.inverse()).log() / (2 * h)
    np.testing.assert_allclose(jacobian(arm, q), J, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(jacobian(arm, q[7]), jacobian(arm, q)[7])


@arms
def test_manipulability_is_the_jacobians_determinant(arm):
    q = sample(arm, 2, (10_000,))
    np.testing.assert_allclose(manipulability(arm, q), np.abs(np.linalg.det(jacobian(arm, q))), rtol=0, atol=1e-15)


@pytest.mark.parametrize("arm", [PSM_CLASSIC, PSM_SI], ids=lambda arm: arm.name)
def test_the_psm_determinant_has_its_closed_form(arm):
    q = sample(arm, 2, (1000,))
    d = q[:, 2] - 0.4318 + 0.4162
    exact = np.abs(np.cos(q[:, 1]) * d * (d * np.cos(q[:, 4]) + 0.0091))
    np.testing.assert_allclose(manipulability(arm, q), exact, rtol=0, atol=1e-15)


@arms
def test_the_depth_is_that_of_the_pitch_axis(arm):
    q = sample(arm, 4, (1000,))
    poses = frames(arm, q).matrix
    wrist, along = poses[..., 5, :3, 3], -arm.wrist_sign * poses[..., 4, :3, 2]
    np.testing.assert_allclose(wrist_depth_m(arm, q), np.sum(wrist * along, -1), rtol=0, atol=1e-12)


@arms
def test_a_joint_beyond_its_range_is_named_with_its_excess(arm):
    q = arm.middle.copy()
    assert limit_violations(arm, q) == []
    q[2] = arm.upper[2] + 0.05
    (sentence,) = limit_violations(arm, np.array([arm.middle, q]))
    assert "'insertion'" in sentence
    assert "by 0.0500" in sentence
    assert " m " in sentence


@arms
def test_from_where_joints_are_counted_changes_nothing(arm):
    other, q = recounted(arm), sample(arm, 6, (50,))
    for measure in (jacobian, manipulability, wrist_depth_m):
        np.testing.assert_allclose(measure(other, q - SHIFT), measure(arm, q), rtol=0, atol=1e-14)


def test_each_joint_is_named_at_its_worst_whichever_end_it_leaves():
    q = np.tile(PSM_CLASSIC.middle, (4, 1))
    q[1, 0], q[2, 0] = PSM_CLASSIC.upper[0] + 0.02, PSM_CLASSIC.lower[0] - 0.1
    q[3, 5] = PSM_CLASSIC.upper[5] + 0.3
    yaw, wrist = limit_violations(PSM_CLASSIC, q.reshape(2, 2, 6))
    assert "'yaw'" in yaw and "by 0.1000" in yaw
    assert "'wrist_yaw'" in wrist and "by 0.3000" in wrist
    assert limit_violations(PSM_CLASSIC, [PSM_CLASSIC.lower, PSM_CLASSIC.upper]) == []


@arms
def test_bad_joint_values_are_refused(arm):
    for function in (jacobian, manipulability, limit_violations):
        with pytest.raises(TrocarError, match="shape"):
            function(arm, np.zeros(5))
