from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from plant_models import FAR, HOME, plant_model, recorded
from trocar.calibration.compensation import HysteresisState
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PSM1_GREY, play_operator
from trocar.trajectory import Trajectory


@pytest.fixture(scope="module")
def models():
    rng = np.random.default_rng(0)
    recording = recorded(PSM1_GREY, rng, 400)
    return {name: MODELS[name].fit(recording, rng) for name in ("play", "ridge", "offset")}


def there_and_back():
    times = np.linspace(0.0, 2.0, 41)
    share = np.sin(np.pi * times / 2) ** 2
    rate = np.pi / 2 * np.sin(np.pi * times)
    return Trajectory.hermite(times, HOME + share[:, None] * (FAR - HOME), rate[:, None] * (FAR - HOME))


def same(one, other, atol=1e-9):
    probe = HOME + 0.05
    return np.allclose(one.joints(probe), other.joints(probe), atol=atol)


def test_the_play_model_remembers_every_command(models):
    sent, memory = there_and_back(), HysteresisState.at_rest(models["play"], HOME)
    for until_s in (0.3, 1.0, 1.4, 2.0):
        u = models["play"].inputs(sent(np.linspace(0.0, until_s, 4001)))
        state = play_operator(u[:, :, None], models["play"].radii)[-1]
        assert_allclose(memory.after(sent, until_s).state, state, atol=1e-4)
    assert not same(memory.after(sent, 2.0), memory, atol=0.02), "the way there and back leaves slack"


@pytest.mark.parametrize("name", ["play", "ridge", "offset"])
def test_in_pieces_as_at_once(models, name):
    sent, whole = there_and_back(), HysteresisState.at_rest(models[name], HOME)
    pieces, at = whole, 0.0
    for piece_s in (0.2, 0.02, 0.5, 0.1, 0.4, 0.78):
        times = np.linspace(at, at + piece_s, 60)
        part = Trajectory.hermite(times - at, sent(times), sent(times, 1))
        pieces, at = pieces.after(part, piece_s), at + piece_s
    whole = whole.after(sent, 2.0)
    assert same(whole, pieces, atol=2e-3)
    assert same(whole, whole.after(Trajectory.hermite([0.0, 1.0], [HOME, HOME], np.zeros((2, 6))), 1.0)), "a rest"


def test_a_window_spans_motion_and_not_time(models):
    """However often an arm is stopped or its motion replanned, the window holds steps as large as in training."""
    ridge = models["ridge"]
    sent, memory = there_and_back(), HysteresisState.at_rest(ridge, HOME)
    for start in np.arange(0.0, 1.2, 0.02):
        times = np.linspace(start, start + 0.02, 5)
        memory = memory.after(Trajectory.hermite(times - start, sent(times), sent(times, 1)), 0.02)
    steps = np.abs(np.diff(memory.state, axis=0)) / ridge.training.interval
    assert (steps.max(axis=1) > 0.99).all()
    assert np.median(steps.max(axis=1)) < 1.5
    assert (np.abs(sent(1.2) - memory.q_cmd) <= ridge.training.interval + 1e-12).all()


def test_a_joint_that_never_moved_in_training_takes_no_samples(models):
    training = models["ridge"].training
    still = replace(training, interval=np.where(np.arange(6) == 3, 0.0, training.interval))
    memory = HysteresisState.at_rest(replace(models["ridge"], training=still), HOME)
    assert memory.step(HOME + 1e-6)[1] is memory
    assert memory.step(HOME + 0.2)[1] is not memory


def test_a_lift_with_a_still_wrist_leaves_the_window_as_it_was(models):
    memory = HysteresisState.at_rest(models["ridge"], HOME).after(there_and_back(), 0.7)
    lifted = memory.q_cmd + np.array([0.1, 0.1, 0.03, 0.0, 0.0, 0.0])
    assert memory.step(lifted)[1] is memory
    assert np.abs(memory.joints(lifted) - memory.joints(memory.q_cmd))[:3].max() > 0.09


@pytest.mark.parametrize("name", ["play", "ridge", "offset"])
def test_joints_along_a_path_are_those_of_step_after_step(models, name):
    memory = HysteresisState.at_rest(models[name], HOME)
    path = there_and_back()(np.linspace(0.0, 2.0, 50))
    expected, stepping = [], memory
    for q in path:
        joints, stepping = stepping.step(q)
        expected.append(joints)
    assert_allclose(memory.along(path), expected, atol=1e-12)
    assert_allclose(memory.joints(path[0]), expected[0], atol=1e-12)


# A model that is a plant.

PLANT = plant_model(PSM1_GREY)


def test_what_was_sent_counts_up_to_a_time_within_it():
    sent, memory = there_and_back(), HysteresisState.at_rest(PLANT, HOME)
    assert_allclose(memory.after(sent, 99.0).state, memory.after(sent, 2.0).state)
    for begin in (0.0, -1.0):
        assert_allclose(memory.after(sent, begin).state, memory.state, atol=1e-12)
        assert_allclose(memory.after(sent, begin).q_cmd, HOME, atol=1e-12)
    assert_allclose(memory.after(sent, 0.7).q_cmd, sent(0.7))
    later = Trajectory(sent.times_s + 5.0, sent.coefficients)
    assert_allclose(memory.after(later, 5.7).state, memory.after(sent, 0.7).state, atol=1e-9)
    assert_allclose(memory.after(later, 5.7).q_cmd, sent(0.7), atol=1e-12)


def test_the_hardest_turn_between_two_replayed_commands_hides_little():
    """Roll turns at 25 rad/s^2, halfway between two of them."""
    peak = 0.4
    start = HOME.copy()
    start[3] = peak - 12.5 * 0.05**2
    coefficients = np.zeros((3, 1, 6))
    coefficients[2, 0], coefficients[1, 0, 3], coefficients[0, 0, 3] = start, 25 * 0.05, -12.5
    sent = Trajectory(np.array([0.0, 0.1]), coefficients)
    assert sent(0.05)[3] == peak
    state = HysteresisState.at_rest(PLANT, start).after(sent, 0.1).state
    hidden = peak - PSM1_GREY.radii[0] - state[0, 0]
    assert 0 <= hidden <= 5.1e-5


def test_an_arm_rests_where_it_is_told_to():
    memory = HysteresisState.at_rest(PLANT, list(HOME))
    assert memory.q_cmd.shape == (6,) and np.array_equal(memory.q_cmd, HOME)
    joints, after = memory.step(HOME)
    assert_allclose(joints[3:], HOME[3:] + PSM1_GREY.offset + PSM1_GREY.K @ HOME[3:])
    assert_allclose(after.state, memory.state)


def test_a_sample_is_taken_where_a_joint_of_the_wrist_has_gone_on_by_its_step(models):
    ridge = models["ridge"]
    memory, step = HysteresisState.at_rest(ridge, HOME), ridge.training.interval
    for joint in (3, 4, 5):
        for sign in (1.0, -1.0):
            to = sign * step * (np.arange(6) == joint)
            assert memory.step(HOME + 0.999 * to)[1] is memory
            assert memory.step(HOME + 1.001 * to)[1] is not memory
    sample = memory.step(HOME + 1.001 * step)[1]
    assert np.array_equal(sample.q_cmd, HOME + 1.001 * step)
    assert np.array_equal(sample.state[-1], sample.q_cmd) and np.array_equal(sample.state[:-1], memory.state[1:])
