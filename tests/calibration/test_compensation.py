import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS
from trocar.calibration.compensation import Compensator, resample, sample_positions
from trocar.calibration.excitation import PSM1_BOX, MotionBox, random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.plant import PLANTS
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError

ARM = next(iter(ARMS.values()))
WASHOUT = 20


def record(plant, rng, n=1355):
    q = random_smooth_path(ARM, rng, n)
    return Recording(q, plant.measure(plant.run(q), rng), np.ones(n, bool), 0.8 * np.arange(n))


def closed_loop(plant, compensator, desired):
    """The plant's true error along a path that starts at rest, without measurement noise."""
    compensator.start(desired[0])
    q_cmd = compensator.path(desired)
    return (plant.run(np.vstack([desired[:1], q_cmd]))[1:] - desired)[WASHOUT:, 3:]


@pytest.fixture(scope="module")
def play():
    plant = PLANTS["psm1_grey"]
    return plant, MODELS["play"].fit(record(plant, np.random.default_rng(0)), np.random.default_rng(0))


def wider():
    push = np.array([0, 0, 0, 0.3, 0.11, 0.11])
    return MotionBox(PSM1_BOX.lower - push, PSM1_BOX.upper + push, PSM1_BOX.step)


def small():
    lower, upper = np.array([0.7, 0, 0.15, -1.4, -0.1, -0.1]), np.array([0.9, 0.1, 0.2, -1.0, 0.15, 0.15])
    return MotionBox(lower, upper, PSM1_BOX.step / 3)


@pytest.mark.parametrize("box", [PSM1_BOX, wider(), small()], ids=["same", "wider", "small"])
def test_the_exact_inverse_closes_the_loop(play, box):
    plant, model = play
    error = closed_loop(plant, Compensator(model), random_smooth_path(ARM, np.random.default_rng(7), 300, box))
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.006)


@pytest.mark.parametrize("name", ["psm2_grey", "psm1_new"])
def test_it_closes_the_loop_for_every_instrument(name):
    plant = PLANTS[name]
    model = MODELS["play"].fit(record(plant, np.random.default_rng(1)), np.random.default_rng(0))
    desired = random_smooth_path(ARM, np.random.default_rng(8), 300)
    error = closed_loop(plant, Compensator(model), desired)
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.006)


def test_algorithm1_halves_the_error_with_any_model():
    plant = PLANTS["psm1_grey"]
    model = MODELS["ridge"].fit(record(plant, np.random.default_rng(0)), np.random.default_rng(0))
    desired = random_smooth_path(ARM, np.random.default_rng(9), 300)
    compensator = Compensator(model)
    assert compensator.method == "algorithm1"
    after = np.sqrt(np.mean(closed_loop(plant, compensator, desired) ** 2, axis=0))
    before = np.sqrt(np.mean((plant.run(desired) - desired)[WASHOUT:, 3:] ** 2, axis=0))
    assert np.all(after < 0.5 * before)


def test_algorithm1_leaves_its_known_share_of_a_constant_offset():
    offset = np.array([0, 0, 0, 0.26, -0.1, 0.1])
    training = TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 100)
    model = MODELS["offset"](offset, training)
    q = np.zeros((1, 6))
    left = Compensator(model, "algorithm1", iterations=5, alpha=0.5).path(q) + offset
    assert_allclose(left[0], offset * 0.5**5, atol=1e-15)


def test_history_is_carried_from_call_to_call(play):
    _, model = play
    desired = random_smooth_path(ARM, np.random.default_rng(3), 60)
    one, two = Compensator(model), Compensator(model)
    whole = one.path(desired)
    parts = np.vstack([two.path(desired[:25]), two.path(desired[25:])])
    assert_allclose(whole, parts, atol=1e-12)


def test_predictions_of_the_commands_are_the_desired_joints(play):
    _, model = play
    desired = random_smooth_path(ARM, np.random.default_rng(4), 200)
    q_cmd = Compensator(model).path(desired)
    predicted = model.predict(np.vstack([desired[:1], q_cmd]))[1:]
    assert np.abs(predicted - desired)[:, 3:].max() < 2e-3


def test_resampling_keeps_the_corners_and_the_interval():
    interval = np.array([0.01, 0.01, 0.002, 0.08, 0.06, 0.07])
    training = TrainingMotion(interval, np.zeros(6), np.ones(6), 100)
    path = np.array([np.zeros(6), [0.1, 0, 0, 0.5, 0, 0], [0.1, 0, 0.05, 0.5, 0, 0.3]])
    q = resample(path, training)
    assert np.all(np.abs(np.diff(q, axis=0)) <= interval + 1e-12)
    for corner in path:
        assert np.abs(q - corner).max(axis=1).min() < 1e-12
    at = sample_positions(path, training)
    assert len(at) == len(q)
    assert at[0] == 0
    assert at[-1] == 2


@pytest.mark.parametrize("arguments", [{"method": "magic"}, {"iterations": 0}, {"alpha": 1.5}])
def test_bad_settings_are_refused(play, arguments):
    with pytest.raises(TrocarError):
        Compensator(play[1], **arguments)


@pytest.mark.parametrize("path", [np.zeros((3, 5)), np.full((3, 6), np.nan), np.zeros(6)])
def test_bad_paths_are_refused(play, path):
    with pytest.raises(TrocarError):
        Compensator(play[1]).path(path)
