"""How the play model's joints depend on a path of commands, compared with finite differences."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PLANTS, WRIST
from trocar.calibration.recording import Recording


@pytest.fixture(scope="module")
def play():
    """A model of noisy recordings: its map has bumps too."""
    rng, plant = np.random.default_rng(0), PLANTS["psm2_grey"]
    q = random_smooth_path(next(iter(ARMS.values())), rng, 400)
    recording = Recording(q, plant.measure(plant.run(q), rng), np.ones(len(q), bool), 0.8 * np.arange(len(q)))
    model = MODELS["play"].fit(recording, rng)
    assert len(model.map.centres)
    return model


def walk(seed, n=25):
    rng = np.random.default_rng(seed)
    q = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2]) + np.cumsum(rng.normal(size=(n, 6)) * 0.05, axis=0)
    return q, rng


def straight(model, q):
    """Inputs that turn nowhere between the commands."""
    return model.inputs(q[:-1])


def test_joints_and_state_are_those_of_step_after_step(play):
    q, _ = walk(0)
    state = play.start(q[0])
    response = play.respond(state, q, straight(play, q))
    assert_allclose(play.remember(state, q), response.state, atol=1e-12)
    for row, joints in zip(q, response.joints, strict=True):
        expected, state = play.step(state, row)
        assert_allclose(joints, expected, atol=1e-12)
    assert_allclose(response.state, state, atol=1e-12)


def test_a_turn_between_two_commands_leaves_its_slack(play):
    q, _ = walk(1, 2)
    start, beyond = play.start(q[0]), play.inputs(q[1]) + 0.05
    turned = play.respond(start, q, beyond[None])
    over = q[1].copy()
    over[WRIST] = np.linalg.solve(play.mix, beyond)
    expected = play.respond(start, np.array([q[0], over, q[1]]), straight(play, np.array([q[0], over, q[1]])))
    assert_allclose(turned.joints[-1], expected.joints[-1], atol=1e-12)
    assert np.abs(turned.joints[-1] - play.respond(start, q, straight(play, q)).joints[-1]).max() > 3e-3


def test_slopes_are_those_of_small_steps(play):
    q, rng = walk(2)
    state = play.start(q[0]) + rng.uniform(-0.5, 0.5, play.radii.shape) * play.radii
    response = play.respond(state, q, straight(play, q))
    for row in (1, 7, 13, 24):
        for joint in range(3):
            pushed = q.copy()
            pushed[row, 3 + joint] += 1e-6
            moved = play.respond(state, pushed, straight(play, pushed)).joints
            measured = (moved - response.joints)[:, WRIST] / 1e-6
            expected = np.zeros_like(measured)
            expected[row] = response.by_command[row, :, joint]
            for i in range(3):
                driven = (response.moved[:, i] // 2 == row) & (response.moved[:, i] > 0)
                driven[: row + 1] = False
                expected += np.einsum("nak,nk->na", response.by_operator[:, :, i], driven) * play.mix[i, joint]
            assert_allclose(measured, expected, atol=1e-4)


def test_slopes_of_many_are_those_of_each(play):
    rng = np.random.default_rng(3)
    x = rng.normal(size=(9, play.map.linear.shape[1])) * 0.1
    values, gradients = play.map.slopes(x)
    for row, value, gradient in zip(x, values, gradients, strict=True):
        expected = play.map.linearize(row)
        assert_allclose(value, expected[0], atol=1e-12)
        assert_allclose(gradient, expected[1], atol=1e-12)
