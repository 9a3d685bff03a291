"""Errors of joints that are remembered by place."""

import numpy as np
import pytest

from trocar.arms import RAVEN2_LEFT, fk
from trocar.errors import OutOfReach, TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.flaws import MILD, Difficulty
from trocar.lab.transmission import PoseErrorField
from trocar.tasks.debridement.pose import ErrorField, ErrorFilter, HeldError
from trocar.tasks.debridement.pose.error_field import MOST

ARM, START = RAVEN2_LEFT, load_station("raven-pair").arms["left"].park_q()
SWING = np.array([0.25, 0.25, 0.03, 0.3, 0.3, 0.3])
NOISE_M, NOISE_RAD = 3e-4, 8e-3
STEPS = 60


def there_and_back(seed):
    """Return commands (n, 6) of a way that is gone twice, and where cables with errors bring the tip."""
    rng = np.random.default_rng(seed)
    cables = PoseErrorField().drawn(rng, Difficulty.of(MILD))
    share = np.linspace(0.0, 4 * np.pi, 2 * STEPS)[:, None]
    q = START + SWING * np.sin(share + np.linspace(0.0, 2.0, 6)) - SWING * np.sin(np.linspace(0.0, 2.0, 6))
    memory, joints = cables.start(q[0], rng), []
    for command in q:
        error, memory = cables.step(memory, command)
        joints.append(error)
    return q, fk(ARM, np.array(joints)), rng


def seen(T, rng):
    turn = SO3.exp(rng.normal(0.0, NOISE_RAD, 3))
    return SE3.from_parts(turn @ T.rotation, T.translation_m + rng.normal(0.0, NOISE_M, 3))


def away_m(T, other):
    return float(np.linalg.norm(T.translation_m - other.translation_m))


def ahead_m(make, seed, lap, ahead=6):
    """Return the mean error of predictions some steps ahead on one lap of a way that is gone twice."""
    q, true, rng = there_and_back(seed)
    kinematic, estimator, errors = fk(ARM, q), make(), []
    for i in range(2 * STEPS - ahead):
        estimator.update(0.1 * i, kinematic[i], seen(true[i], rng))
        if i // STEPS == lap and i % STEPS > ahead:
            errors.append(away_m(estimator.settled(kinematic[i + ahead]), true[i + ahead]))
    return float(np.mean(errors))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_an_arm_has_been_it_knows_what_comes(seed):
    first, again = (ahead_m(lambda: ErrorField(ARM), seed, lap) for lap in (0, 1))
    assert again < 0.0015
    assert again < 0.5 * first
    assert again < 0.3 * min(ahead_m(make, seed, 1) for make in (ErrorFilter, HeldError))


def test_without_detections_the_estimate_is_the_kinematics():
    field = ErrorField(ARM)
    T = fk(ARM, START)
    field.update(0.0, T, None)
    assert np.array_equal(field.estimate(1.0, T).matrix, T.matrix)


def test_one_wrong_detection_counts_little_and_five_are_believed():
    q, true, rng = there_and_back(4)
    kinematic, field = fk(ARM, q), ErrorField(ARM)
    for i in range(STEPS):
        field.update(0.1 * i, kinematic[i], seen(true[i], rng))
    last, wrong = kinematic[STEPS - 1], SE3.from_parts(translation_m=[0.0, 0.03, 0.0]) @ true[STEPS - 1]
    field.update(7.0, last, wrong)
    assert away_m(field.settled(last), true[STEPS - 1]) < 0.004
    for i in range(4):
        field.update(7.1 + 0.1 * i, last, wrong)
    assert away_m(field.settled(last), wrong) < 0.001


def test_it_keeps_the_newest_detections_only():
    q, true, rng = there_and_back(5)
    kinematic, field = fk(ARM, q), ErrorField(ARM)
    for i in range(6 * len(q)):
        field.update(0.1 * i, kinematic[i % len(q)], seen(true[i % len(q)], rng))
    assert len(field._ways) == MOST
    assert field._ways[-1] == field._way


def test_time_runs_forwards_and_poses_need_joints():
    field = ErrorField(ARM)
    field.update(1.0, fk(ARM, START), fk(ARM, START))
    with pytest.raises(TrocarError, match=r"at 0\.5 s came after one at 1\.0 s"):
        field.estimate(0.5, fk(ARM, START))
    with pytest.raises(OutOfReach, match="no joints of raven2-left"):
        field.settled(SE3.identity())
