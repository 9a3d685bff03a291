from itertools import pairwise

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose import PaperAdjustment
from trocar.tasks.debridement.pose.estimators import interpolate

ERROR = SE3.exp([0.02, -0.004, 0.03, 0.1, -0.2, 0.3])
NONE = SE3.identity()


def random_walk(rng, n):
    """Return poses with large random increments between them."""
    poses = [SE3.identity()]
    for _ in range(n):
        poses.append(poses[-1] @ SE3.exp([*rng.normal(0, 0.02, 3), *rng.normal(0, 0.6, 3)]))
    return poses


def with_increments(T_left, kinematic, T_right):
    """Return detected poses whose increments are ``T_left dT_K T_right``."""
    detected = [SE3.identity()]
    for before, after in pairwise(kinematic):
        detected.append(detected[-1] @ T_left @ before.inverse() @ after @ T_right)
    return detected


def run(kinematic, detected):
    """Return the rule after all pairs, and how far (m and rad in one) each prediction was off one pair ahead."""
    rule, off = PaperAdjustment(), []
    for i, (T_kinematic, T_detected) in enumerate(zip(kinematic, detected, strict=True)):
        off.append(distance(rule.estimate(i, T_kinematic), T_detected))
        rule.update(i, T_kinematic, T_detected)
    return rule, off


def distance(T, other):
    return np.linalg.norm((T.inverse() @ other).log())


@pytest.mark.parametrize(
    ("T_left", "T_right"), [(ERROR, NONE), (NONE, ERROR), (ERROR, SE3.exp([0.01, 0, 0, 0, 0.1, 0]))]
)
def test_constant_adjustments_are_recovered(T_left, T_right):
    kinematic = random_walk(np.random.default_rng(1), 200)
    rule, off = run(kinematic, with_increments(T_left, kinematic, T_right))
    assert off[1] > 0.1
    assert max(off[-5:]) < 1e-3
    assert distance(rule.T_left, T_left) < 1e-3
    assert distance(rule.T_right, T_right) < 1e-3


def test_a_constant_error_in_the_base_needs_no_adjustment():
    kinematic = random_walk(np.random.default_rng(2), 10)
    rule, off = run(kinematic, [ERROR @ T for T in kinematic])
    assert max(off[1:]) < 1e-12
    assert distance(rule.T_left, NONE) < 1e-12


def test_a_constant_error_of_the_tool_is_recovered():
    kinematic = random_walk(np.random.default_rng(3), 200)
    rule, off = run(kinematic, [T @ ERROR for T in kinematic])
    assert max(off[-5:]) < 1e-3
    assert distance(rule.T_left, ERROR.inverse()) < 1e-3
    assert distance(rule.T_right, ERROR) < 1e-3


def test_updates_alternate_and_go_half_way():
    step = SE3.exp([0.01, 0, 0, 0, 0, 0.2])
    rule = PaperAdjustment()
    rule.update(0, NONE, NONE)
    rule.update(1, NONE, step)
    assert np.array_equal(rule.T_right.matrix, NONE.matrix)
    assert np.allclose(rule.T_left.rotation.log(), [0, 0, 0.1])
    assert np.allclose(rule.T_left.translation_m, step.translation_m / 2)
    T_left = rule.T_left
    rule.update(2, NONE, step @ step)
    assert np.array_equal(rule.T_left.matrix, T_left.matrix)
    # (L dT_K)^-1 dT_c, half-way; with detected and kinematic increments swapped this would turn the other way
    assert np.allclose(rule.T_right.rotation.log(), [0, 0, 0.05])


def test_interpolation_is_linear_in_position_and_spherical_in_rotation():
    T_to = SE3.from_parts(SO3.axis("x", 1.0), [0.4, 0.0, 0.0])
    T = interpolate(NONE, T_to, 0.25)
    assert np.allclose(T.translation_m, [0.1, 0, 0])
    assert np.allclose(T.rotation.log(), [0.25, 0, 0])
    assert distance(interpolate(ERROR, T_to, 1.0), T_to) < 1e-12


@pytest.mark.parametrize("share", [0, -1, 1.5, float("nan")])
def test_a_share_outside_its_range_is_refused(share):
    with pytest.raises(TrocarError, match="share of the way"):
        PaperAdjustment(share)
