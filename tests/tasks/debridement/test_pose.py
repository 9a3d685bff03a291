"""Where a gripper is, by the paper's rule and by errors of joints that are remembered by place."""

from itertools import pairwise

import numpy as np
import pytest
from error_filter import ErrorFilter
from gripper_pose import HeldError

from trocar.arms import RAVEN2_LEFT, fk
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.flaws import MILD, Difficulty
from trocar.lab.transmission import PoseErrorField
from trocar.tasks.debridement.pose import MOST, ErrorField, PaperAdjustment, interpolate

ERROR = SE3.exp([0.02, -0.004, 0.03, 0.1, -0.2, 0.3])
NONE = SE3.identity()
ARM, START = RAVEN2_LEFT, load_station("raven-pair").arms["left"].park_q()


def distance(T, other):
    return np.linalg.norm((T.inverse() @ other).log())


def away_m(T, other):
    return float(np.linalg.norm(T.translation_m - other.translation_m))


@pytest.mark.parametrize("make", [PaperAdjustment, lambda: ErrorField(ARM)])
def test_without_detections_the_estimate_is_the_kinematics(make):
    T = fk(ARM, START)
    assert np.array_equal(make().estimate(T).matrix, T.matrix)


# The paper's rule (V-A.2).


def random_walk(seed, n):
    """Return poses with large random increments between them."""
    rng, poses = np.random.default_rng(seed), [SE3.identity()]
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
    for T_kinematic, T_detected in zip(kinematic, detected, strict=True):
        off.append(distance(rule.estimate(T_kinematic), T_detected))
        rule.learn(T_kinematic, T_detected)
    return rule, off


@pytest.mark.parametrize(
    ("T_left", "T_right"),
    [(ERROR, NONE), (NONE, ERROR), (ERROR, SE3.exp([0.01, 0, 0, 0, 0.1, 0])), (ERROR.inverse(), ERROR)],
)
def test_constant_adjustments_are_recovered(T_left, T_right):
    """The last case is a constant error of the tool."""
    kinematic = random_walk(1, 200)
    rule, off = run(kinematic, with_increments(T_left, kinematic, T_right))
    assert off[1] > 0.1 and max(off[-5:]) < 1e-3
    assert distance(rule.T_left, T_left) < 1e-3 and distance(rule.T_right, T_right) < 1e-3


def test_a_constant_error_in_the_base_needs_no_adjustment():
    kinematic = random_walk(2, 10)
    rule, off = run(kinematic, [ERROR @ T for T in kinematic])
    assert max(off[1:]) < 1e-12 and distance(rule.T_left, NONE) < 1e-12


def test_updates_alternate_and_go_half_way():
    step = SE3.exp([0.01, 0, 0, 0, 0, 0.2])
    rule = PaperAdjustment()
    rule.learn(NONE, NONE)
    rule.learn(NONE, step)
    assert np.array_equal(rule.T_right.matrix, NONE.matrix)
    assert np.allclose(rule.T_left.rotation.log(), [0, 0, 0.1])
    assert np.allclose(rule.T_left.translation_m, step.translation_m / 2)
    T_left = rule.T_left
    rule.learn(NONE, step @ step)
    assert np.array_equal(rule.T_left.matrix, T_left.matrix)
    # (L dT_K)^-1 dT_c, half-way; with detected and kinematic increments swapped this would turn the other way
    assert np.allclose(rule.T_right.rotation.log(), [0, 0, 0.05])


def test_an_arm_at_rest_is_where_it_was_detected_and_only_its_motion_is_adjusted():
    """While the arm moves, the adjustments learn shifts that an arm at rest does not make."""
    kinematic = random_walk(5, 20)
    detected = with_increments(ERROR, kinematic, SE3.exp([0.01, 0, 0, 0, 0.1, 0]))
    rule, _ = run(kinematic, detected)
    assert np.linalg.norm((rule.T_left @ rule.T_right).translation_m) > 5e-4
    assert np.array_equal(rule.estimate(kinematic[-1]).matrix, detected[-1].matrix)
    step = SE3.from_parts(translation_m=(0.0, 0.0, 0.010))
    expected = detected[-1] @ rule.T_left @ step @ rule.T_right
    assert np.allclose(rule.estimate(kinematic[-1] @ step).matrix, expected.matrix, atol=1e-12)


def test_interpolation_is_linear_in_position_and_spherical_in_rotation():
    T_to = SE3.from_parts(SO3.axis("x", 1.0), [0.4, 0.0, 0.0])
    T = interpolate(NONE, T_to, 0.25)
    assert np.allclose(T.translation_m, [0.1, 0, 0]) and np.allclose(T.rotation.log(), [0.25, 0, 0])
    assert distance(interpolate(ERROR, T_to, 1.0), T_to) < 1e-12


# Errors of joints, remembered by place.

SWING = np.array([0.25, 0.25, 0.03, 0.3, 0.3, 0.3])
NOISE_M, NOISE_RAD = 3e-4, 8e-3
STEPS = 60


def there_and_back(seed):
    """Return kinematic poses of a way that is gone twice, and where cables with errors bring the tip."""
    rng = np.random.default_rng(seed)
    cables = PoseErrorField().drawn(rng, Difficulty.of(MILD))
    share = np.linspace(0.0, 4 * np.pi, 2 * STEPS)[:, None]
    q = START + SWING * np.sin(share + np.linspace(0.0, 2.0, 6)) - SWING * np.sin(np.linspace(0.0, 2.0, 6))
    memory, joints = cables.start(q[0], rng), []
    for command in q:
        error, memory = cables.step(memory, command)
        joints.append(error)
    return fk(ARM, q), fk(ARM, np.array(joints)), rng


def seen(T, rng):
    turn = SO3.exp(rng.normal(0.0, NOISE_RAD, 3))
    return SE3.from_parts(turn @ T.rotation, T.translation_m + rng.normal(0.0, NOISE_M, 3))


def ahead_m(learn, estimate, seed, lap, ahead=6):
    """Return the mean error of predictions some steps ahead on one lap of a way that is gone twice."""
    kinematic, true, rng = there_and_back(seed)
    errors = []
    for i in range(2 * STEPS - ahead):
        learn(kinematic[i], seen(true[i], rng))
        if i // STEPS == lap and i % STEPS > ahead:
            errors.append(away_m(estimate(kinematic[i + ahead]), true[i + ahead]))
    return float(np.mean(errors))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_an_arm_has_been_it_knows_what_comes(seed):
    def error_m(lap):
        field = ErrorField(ARM)
        return ahead_m(field.learn, field.estimate, seed, lap)

    def others_m(other):
        times_s = []

        def learn(T_kinematic, T_detected):
            times_s.append(0.1 * len(times_s))
            other.update(times_s[-1], T_kinematic, T_detected)

        return ahead_m(learn, lambda T_kinematic: other.estimate(times_s[-1], T_kinematic), seed, 1)

    first, again = error_m(0), error_m(1)
    assert again < 0.0015 and again < 0.5 * first
    assert again < 0.3 * min(others_m(other) for other in (HeldError(), ErrorFilter()))


def test_one_wrong_detection_counts_little_and_five_are_believed():
    kinematic, true, rng = there_and_back(4)
    field = ErrorField(ARM)
    for i in range(STEPS):
        field.learn(kinematic[i], seen(true[i], rng))
    last, wrong = kinematic[STEPS - 1], SE3.from_parts(translation_m=[0.0, 0.03, 0.0]) @ true[STEPS - 1]
    field.learn(last, wrong)
    assert away_m(field.estimate(last), true[STEPS - 1]) < 0.004
    for _ in range(4):
        field.learn(last, wrong)
    assert away_m(field.estimate(last), wrong) < 0.001


def test_it_keeps_the_newest_detections_only():
    kinematic, true, rng = there_and_back(5)
    field = ErrorField(ARM)
    for i in range(12 * STEPS):
        field.learn(kinematic[i % (2 * STEPS)], seen(true[i % (2 * STEPS)], rng))
    assert len(field._ways) == MOST and field._ways[-1] == field._way


def test_poses_need_joints():
    field = ErrorField(ARM)
    field.learn(fk(ARM, START), fk(ARM, START))
    field.learn(fk(ARM, START), SE3.identity())  # a false detection: no pose of this gripper
    assert len(field._ways) == 1
    with pytest.raises(OutOfReach, match="no joints of raven2-left"):
        field.estimate(SE3.identity())
