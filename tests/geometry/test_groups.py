"""SO3 and SE3 by their axioms, over batch shapes, near the identity and near half a turn; directions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, direction
from trocar.geometry.so3 import skew

BATCHES = [(), (1,), (7,), (2, 3)]
ANGLES = [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-8, np.pi]
seeds = st.integers(0, 2**32 - 1)


def rotvecs(rng, batch, angle):
    axis = rng.standard_normal((*batch, 3))
    return angle * axis / np.linalg.norm(axis, axis=-1, keepdims=True)


def elements(group, rng, batch, angle):
    w = rotvecs(rng, batch, angle)
    if group is SO3:
        return SO3.exp(w)
    return SE3.exp(np.concatenate([rng.uniform(-1, 1, (*batch, 3)), w], -1))


@pytest.mark.parametrize("group", [SO3, SE3])
@pytest.mark.parametrize("batch", BATCHES)
@given(seed=seeds, angle=st.sampled_from(ANGLES))
def test_axioms(group, batch, seed, angle):
    rng = np.random.default_rng(seed)
    a, b, c = (elements(group, rng, batch, angle) for _ in range(3))
    one = group.identity(batch)
    point = rng.uniform(-1, 1, (*batch, 3))
    np.testing.assert_allclose((a @ a.inverse()).matrix, one.matrix, atol=1e-14)
    np.testing.assert_allclose((a.inverse() @ a).matrix, one.matrix, atol=1e-14)
    np.testing.assert_array_equal((a @ one).matrix, a.matrix)
    np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=1e-14)
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-14)
    assert a.matrix.shape[:-2] == batch
    R = a.matrix[..., :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)


@pytest.mark.parametrize("group", [SO3, SE3])
@given(seed=seeds, angle=st.sampled_from(ANGLES))
def test_exp_and_log_are_inverse(group, seed, angle):
    rng = np.random.default_rng(seed)
    a = elements(group, rng, (4,), angle)
    np.testing.assert_allclose(group.exp(a.log()).matrix, a.matrix, atol=2e-15 if angle < 3.1 else 5e-14)


@given(seed=seeds, angle=st.sampled_from(ANGLES[:-1]))
def test_log_keeps_the_relative_precision_of_small_angles(seed, angle):
    w = rotvecs(np.random.default_rng(seed), (4,), angle)
    np.testing.assert_allclose(SO3.exp(w).log(), w, rtol=1e-7 if angle > 3.1 else 1e-13, atol=1e-15)


@given(seed=seeds, angle=st.sampled_from(ANGLES))
def test_exp_is_the_matrix_exponential(seed, angle):
    rng = np.random.default_rng(seed)
    v, w = rng.uniform(-1, 1, 3), rotvecs(rng, (), angle)
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(w), v
    np.testing.assert_allclose(SE3.exp(np.r_[v, w]).matrix, expm(generator), atol=1e-13)


@given(seed=seeds, angle=st.sampled_from(ANGLES))
def test_quaternions_agree_with_scipy(seed, angle):
    rng = np.random.default_rng(seed)
    w = rotvecs(rng, (5,), angle)
    R = SO3.exp(w)
    q = R.as_quaternion()
    assert np.all(q[..., 0] >= 0)
    np.testing.assert_allclose(np.abs(np.sum(q * Rotation.from_rotvec(w).as_quat()[:, [3, 0, 1, 2]], -1)), 1.0)
    np.testing.assert_allclose(SO3.from_quaternion(-3 * q).matrix, R.matrix, atol=1e-14)


@given(seed=seeds, angle=st.sampled_from(ANGLES))
def test_the_adjoint_carries_twists(seed, angle):
    rng = np.random.default_rng(seed)
    T, xi = elements(SE3, rng, (3,), angle), rng.uniform(-0.5, 0.5, (3, 6))
    carried = np.einsum("...ij,...j->...i", T.adjoint(), xi)
    np.testing.assert_allclose((T @ SE3.exp(xi)).matrix, (SE3.exp(carried) @ T).matrix, atol=1e-13)


@pytest.mark.parametrize("axis", "xyz")
def test_coordinate_axes_turn_the_right_way(axis):
    i = "xyz".index(axis)
    turned = SO3.axis(axis, np.pi / 2).apply(np.eye(3)[(i + 1) % 3])
    np.testing.assert_allclose(turned, np.eye(3)[(i + 2) % 3], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SO3(np.eye(4)), r"shape \(\.\.\., 3, 3\), got \(4, 4\)"),
        (lambda: SE3(np.eye(3)), r"shape \(\.\.\., 4, 4\), got \(3, 3\)"),
        (lambda: SE3("here"), "numbers of shape .* got 'here'"),
        (lambda: SE3([[1.0], [2.0, 3.0]]), "numbers of shape"),
        (lambda: SE3(1j * np.eye(4)), "numbers of shape"),
        (lambda: SE3(np.full((4, 4), np.nan)), r"must be finite, got nan at \[0, 0\]"),
        (lambda: SO3(np.diag([1.0, 1.0, np.inf])), r"must be finite, got inf at \[2, 2\]"),
        (lambda: SE3(2 * np.eye(4)), "length 1 at right angles .* off by 3"),
        (lambda: SE3(1e300 * np.eye(4)), "length 1 at right angles .* off by inf"),
        (lambda: SO3(np.stack([np.eye(3), np.tri(3)])), r"off by 2, first at \[1\]"),
        (lambda: SO3(np.diag([1.0, 1.0, -1.0])), "reflection"),
        (lambda: SE3(np.diag([1.0, -1.0, 1.0, 1.0])), "reflection"),
        (lambda: SE3(np.eye(4) + np.outer([0, 0, 0, 1], [0.1, 0, 0, 0])), "last row"),
        (lambda: SO3.axis("w", 1.0), "'w' is not one of"),
        (lambda: SO3.axis("x", np.nan), "must be finite"),
        (lambda: SO3.exp(np.zeros(2)), "shape"),
        (lambda: SE3.exp(np.zeros(3)), "shape"),
        (lambda: SO3.from_quaternion(np.zeros(4)), "length above 0"),
        (lambda: SO3.from_quaternion([1.0, np.nan, 0.0, 0.0]), "finite"),
        (lambda: SE3.from_parts(translation_m=np.zeros(2)), "shape"),
        (lambda: SE3.from_parts(translation_m=[0.0, 0.0, np.inf]), "finite"),
        (lambda: SO3.nearest(np.diag([1.0, 1.0, -1.0])), "near no rotation"),
        (lambda: SE3.identity()[0], "index 0 cuts poses apart"),
        (lambda: SO3.identity((2,))[0, 1], "cuts rotations apart"),
    ],
)
def test_what_is_no_rotation_or_pose_is_refused_in_one_sentence(make, words):
    with pytest.raises(TrocarError, match=words) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_rounded_matrices_are_mended_by_the_nearest_rotation():
    R = SO3.exp([0.3, -0.5, 0.2])
    rounded = R.matrix.round(3)
    with pytest.raises(TrocarError, match=r"SO3\.nearest"):
        SO3(rounded)
    np.testing.assert_allclose((SO3.nearest(rounded).inverse() @ R).angle(), 0.0, atol=1e-3)
    np.testing.assert_array_equal(SO3(R.matrix.astype(np.float32)).matrix, R.matrix.astype(np.float32))


def test_poses_say_what_they_are_in_millimetres_and_degrees():
    T = SE3.from_parts(SO3.axis("z", np.pi / 6), (0.0106, -0.034, -1e-9))
    assert repr(T) == "<SE3 (10.6, -34.0, 0.0) mm, 30.0 deg about (0.00, 0.00, 1.00)>"
    assert repr(T.rotation) == "<SO3 30.0 deg about (0.00, 0.00, 1.00)>"
    assert repr(SE3.identity()) == "<SE3 (0.0, 0.0, 0.0) mm, not turned>"
    two = SE3(np.stack([T.matrix, np.eye(4)]))
    assert repr(two) == "<SE3 (2,): within (0.0, -34.0, 0.0) to (10.6, 0.0, 0.0) mm>"
    assert repr(two.rotation) == "<SO3 (2,): turned by up to 30.0 deg>"
    assert repr(two[:0]) == "<SE3 (0,): none>"
    assert repr(two[:0].rotation) == "<SO3 (0,): none>"
    assert "nan" in repr(SE3.unchecked(np.full((4, 4), np.nan)))


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1.0, 1e308])
def test_a_vector_of_any_length_has_a_direction(size):
    np.testing.assert_allclose(direction([size, size, 0.0], "up"), [np.sqrt(0.5), np.sqrt(0.5), 0.0], rtol=1e-15)
    turned = SO3.between([0.0, 0.0, size], [size, 0.0, 0.0]).matrix @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(turned, [1.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("vector", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, 1], ["a", 0, 0]])
def test_what_has_no_direction_is_refused_by_name(vector):
    with pytest.raises(TrocarError, match=r"the way up is .*; give three finite numbers that are not all 0"):
        direction(vector, "the way up")
