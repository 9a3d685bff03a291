import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import SE3, fit_rigid

seeds = st.integers(0, 2**32 - 1)


def pose(rng):
    return SE3.exp(np.concatenate([rng.uniform(-1, 1, 3), rng.uniform(-1.8, 1.8, 3)]))


@given(seed=seeds, count=st.integers(3, 40), flat=st.booleans())
def test_exact_points_give_the_exact_pose(seed, count, flat):
    rng = np.random.default_rng(seed)
    T, source = pose(rng), rng.uniform(-0.1, 0.1, (count, 3))
    if flat:
        source[:, 2] = 0.0  # points in a plane allow a reflection, which must not be taken
    fit = fit_rigid(source, T.apply(source))
    if count > 5:  # three random points may nearly lie on a line
        np.testing.assert_allclose(fit.T_target_source.matrix, T.matrix, atol=1e-11)
    assert fit.rms_m < 1e-14
    assert np.linalg.det(fit.T_target_source.rotation.matrix) == pytest.approx(1.0)


@given(seed=seeds)
def test_no_nearby_pose_fits_better(seed):
    rng = np.random.default_rng(seed)
    source = rng.uniform(-0.1, 0.1, (30, 3))
    target = pose(rng).apply(source) + 0.001 * rng.standard_normal(source.shape)
    T = fit_rigid(source, target).T_target_source

    def cost(T):
        return np.sum((T.apply(source) - target) ** 2)

    for twist in 1e-3 * np.vstack([np.eye(6), -np.eye(6)]):
        assert cost(T) < cost(T @ SE3.exp(twist))


def test_wrong_pairs_are_left_out():
    rng = np.random.default_rng(5)
    T, source = pose(rng), rng.uniform(-0.1, 0.1, (60, 3))
    target = T.apply(source) + 0.0002 * rng.standard_normal(source.shape)
    target[:20] += rng.uniform(0.02, 0.1, (20, 3))
    fit = fit_rigid(source, target, inlier_distance_m=0.001, rng=np.random.default_rng(0))
    assert not fit.inliers[:20].any()
    assert fit.inliers[20:].all()
    expected = fit_rigid(source[20:], target[20:])
    np.testing.assert_allclose(fit.T_target_source.matrix, expected.T_target_source.matrix, atol=1e-14)


@pytest.mark.parametrize(
    ("source", "target", "kwargs", "says"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), {}, "at least 3"),
        (np.zeros((5, 3)), np.zeros((4, 3)), {}, "equal shapes"),
        (np.zeros((5, 2)), np.zeros((5, 2)), {}, "shape"),
        (np.zeros((5, 3)), np.zeros((5, 3)), {}, "one line"),
        (np.eye(3), np.full((3, 3), np.inf), {}, r"the target points must be finite, got inf at \[0, 0\]"),
        (np.eye(3), np.eye(3), {"inlier_distance_m": 0.1}, "rng"),
        ("abc", np.eye(3), {}, "source"),
    ],
)
def test_bad_points_are_refused(source, target, kwargs, says):
    with pytest.raises(TrocarError, match=says):
        fit_rigid(source, target, **kwargs)
