from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.calibration import command_fit
from trocar.calibration.cable_memory import CableMemory
from trocar.calibration.command_fit import CommandFit
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.limited_paths import LimitedPaths
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PLANTS, WRIST
from trocar.calibration.quadratic import QuadraticSpline
from trocar.calibration.recording import Recording

HOME = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2])
PAPER = MOTION_LIMITS["paper"]


@pytest.fixture(scope="module")
def fit():
    """A wrist that goes to and fro: operators stay behind at knots and at turns between them."""
    arm, rng, plant = ARMS["psm-classic"], np.random.default_rng(0), PLANTS["psm2_grey"]
    q = random_smooth_path(arm, rng, 400)
    recording = Recording(q, plant.measure(plant.run(q), rng), np.ones(len(q), bool), 0.8 * np.arange(len(q)))
    times = np.linspace(0.0, 1.2, 41)
    spline = QuadraticSpline(times)
    paths = LimitedPaths(spline, HOME, np.zeros(6), PAPER, arm.lower, arm.upper, np.full(41, 0.03))
    swing = np.array([0.02, 0.01, 0.005, 0.25, 0.2, -0.2])
    wanted = HOME + [0, 0, 0, 0.2, -0.1, 0.1] + np.sin(7.3 * times + 0.2)[:, None] * swing
    return CommandFit(paths, CableMemory.at_rest(MODELS["play"].fit(recording, rng), HOME), wanted)


def test_the_nearest_path_keeps_limits_and_goes_where_it_may(fit):
    x = fit.nearest(fit.wanted)
    commands = fit.paths.spline.trajectory(fit.paths.points(x))
    assert_allclose(commands(0.0), HOME, atol=1e-12)
    assert_allclose(commands(1.2, 1), 0.0, atol=1e-9)
    push = np.abs(commands(fit.paths.spline.times_s[:-1], 2)) / PAPER.acceleration
    assert 0.99 < push.max() <= 1.0
    middle = slice(14, 27)
    assert np.abs(commands(fit.paths.spline.times_s) - fit.wanted)[middle].max() < 0.02
    assert np.array_equal(fit.predict(x).q_cmd[0], HOME)


def test_the_nearest_path_stays_inside_the_ranges(fit):
    lower, upper = fit.paths.lower.copy(), fit.paths.upper.copy()
    lower[4], upper[5] = -0.25, 0.05
    boxed = CommandFit(replace(fit.paths, lower=lower, upper=upper), fit.memory, fit.wanted)
    times = np.linspace(0.0, 1.2, 3000)
    free, kept = (one.paths.spline.trajectory(one.paths.points(one.nearest(fit.wanted)))(times) for one in (fit, boxed))
    assert free[:, 4].min() < -0.27 and free[:, 5].max() > 0.07
    assert kept[:, 4].min() >= -0.25 and kept[:, 5].max() <= 0.05
    assert_allclose(kept[:, :4], free[:, :4], atol=1e-4)


def test_slopes_are_those_of_small_steps(fit, monkeypatch):
    """Also through operators that were driven long before, at knots and at turns between them."""
    monkeypatch.setattr(command_fit, "TAUT", 0.0)
    x = fit.nearest(fit.wanted)
    fitted = fit.predict(x)
    slopes = fit._slopes(fitted).toarray().reshape(len(fit.wanted), 3, 6, len(x))
    by_turns = (fitted.response.moved % 2 == 1).any(axis=(1, 2))
    assert by_turns.sum() > 10
    reaches_back = 0
    for point in range(len(x)):
        for joint in range(3):
            moved = x.copy()
            moved[point, 3 + joint] += 1e-7
            measured = (fitted.error - fit.predict(moved).error)[:, WRIST] / 1e-7
            assert_allclose(slopes[:, :, 3 + joint, point], measured, atol=2e-3)
            reaches_back += np.abs(measured[point + 6 :]).max(initial=0.0) > 0.05
    assert reaches_back > 3
    assert not slopes[:, :, :3].any()


def test_refinement_brings_the_joints_nearer_and_meets_the_end(fit):
    weights = fit.paths.weights_s.copy()
    weights[-1] = 1000.0
    strict = CommandFit(replace(fit.paths, weights_s=weights), fit.memory, fit.wanted)
    roughly = strict.predict(strict.nearest(strict.wanted))
    refined = strict.refine(roughly)
    assert refined.cost < 0.1 * roughly.cost
    assert refined.end_error < 1e-3 < roughly.end_error
