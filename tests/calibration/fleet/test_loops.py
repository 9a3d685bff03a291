"""Loops of one shape, and their fit to a recording."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fleets import SHAPE
from trocar.calibration.fleet import prior as module
from trocar.calibration.fleet.prior import FEATURES, LoopShape, fit_loops
from trocar.calibration.models.play_map import DRIFT_RATIOS, DRIFT_ROWS
from trocar.calibration.plant import PSM1_GREY, play_operator
from trocar.calibration.recording import Recording
from walks import walk


def seen(q):
    """Return what the operators of roll, pitch and yaw see along commands (n, 6)."""
    return [q[:, 3], q[:, 4] + 0.1 * q[:, 5], q[:, 5] + 0.15 * q[:, 4]]


def test_slacks_from_any_start_are_those_of_play_operators():
    q = np.random.default_rng(0).normal(0, 0.2, (40, 6))
    starts = np.array([-1.0, 0.0, 0.5])
    slacks = SHAPE.slacks(q, starts)
    for joint, u in enumerate(seen(q)):
        for s, start in enumerate(starts):
            for k, radius in enumerate(SHAPE.banks[joint]):
                expected = u - play_operator(u, radius, u[0] - start * radius)
                assert_allclose(slacks[:, joint, s, k], expected, atol=1e-12)


def test_features_are_a_constant_the_wrist_and_each_joints_slacks_in_turn():
    q = np.random.default_rng(1).normal(0, 0.2, (20, 6))
    features = SHAPE.features(q)
    assert features.shape == (20, FEATURES) and 4 + SHAPE.banks.size == FEATURES
    slacks = [u - play_operator(u, radius) for joint, u in enumerate(seen(q)) for radius in SHAPE.banks[joint]]
    assert_allclose(features, np.column_stack([np.ones(20), q[:, 3:], *slacks]), atol=1e-12)


def test_operators_lie_on_both_sides_of_the_backlash_and_at_it():
    """A sharp corner is between round ones: of each joint one operator is narrower, one wider by up to twice."""
    narrow, own, wide = (SHAPE.banks / SHAPE.radii[:, None]).T
    assert_allclose(own, 1.0)
    assert (narrow < 0.7).all() and (wide > 1.3).all() and (wide <= 2.0).all()


def test_parameters_and_shape_are_the_same():
    assert_allclose(SHAPE.theta, [np.log(0.05), np.log(0.08), np.log(0.11), 0.1, 0.15])
    again = LoopShape.of(SHAPE.theta)
    assert_allclose([*again.radii, again.a, again.b], [0.05, 0.08, 0.11, 0.1, 0.15])


@pytest.fixture
def recording():
    """Errors of all joints with drift, bad rows, and commands about places that are not zero."""
    rng = np.random.default_rng(0)
    q = 0.5 * walk(1, 80) + [0.8, 0.1, 0.2, -0.3, 0.1, 0.2]
    q_phy = q + 0.02 * rng.normal(size=(80, 6)) + 0.1 * SHAPE.features(q)[:, [0, 1, 2, 3, 4, 8]]
    q_phy[:, :3] = q[:, :3] + 0.01 * rng.normal(size=(80, 3)) + 0.02 * q[:, 3:] - 0.01
    return Recording(q, q_phy, rng.random(80) > 0.2, np.arange(80.0), "mine")


@pytest.fixture
def shaped(monkeypatch):
    """Make the search for radii and coupling find ``SHAPE``."""
    values = {key: getattr(PSM1_GREY, key) for key in PSM1_GREY.__dataclass_fields__}
    plant = type(PSM1_GREY)(**(values | {"radii": SHAPE.radii, "a": SHAPE.a, "b": SHAPE.b}))
    monkeypatch.setattr(module, "fit_plant", lambda recording: plant)


def generalised(x, y, penalty, rows):
    """Return the ridge regression where neighbours' errors are alike, and the mean square of what is left, whitened."""
    alike = np.eye(len(rows)) + max(DRIFT_RATIOS) * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)
    weights = np.linalg.solve(x.T @ np.linalg.solve(alike, x) + np.diag(penalty), x.T @ np.linalg.solve(alike, y)).T
    left = y - x @ weights.T
    return weights, np.mean(np.linalg.solve(np.linalg.cholesky(alike), left) ** 2, axis=0)


def test_a_fit_is_a_ridge_regression_whose_errors_drift(recording, shaped):
    found = fit_loops(recording)
    assert found.name == "mine"
    assert_allclose(found.shape, SHAPE.theta)
    rows = np.flatnonzero(recording.valid)
    error = (recording.q_phy - recording.q_cmd)[rows]
    # A constant is free; the wrist's command is kept small a little, slacks more.
    weights, left = generalised(
        SHAPE.features(recording.q_cmd)[rows], error[:, 3:], [0.0] + [0.05] * 3 + [0.15] * 9, rows
    )
    assert_allclose(found.weights, weights, rtol=1e-6, atol=1e-9)
    assert_allclose(found.left[3:], left, rtol=1e-6)
    outside = np.column_stack([np.ones(len(rows)), recording.q_cmd[rows]])
    outer, left = generalised(outside, error[:, :3], [0.0] + [1.0] * 6, rows)
    assert_allclose(found.outer, outer, rtol=1e-6, atol=1e-9)
    assert_allclose(found.left[:3], left, rtol=1e-6)


def test_a_constant_error_is_found_whole(recording, shaped):
    off = np.array([0.01, -0.02, 0.003, 0.2, -0.1, 0.1])
    moved = Recording(recording.q_cmd, recording.q_phy + off, recording.valid, recording.t_s)
    before, after = fit_loops(recording), fit_loops(moved)
    assert_allclose(after.weights[:, 0] - before.weights[:, 0], off[3:], atol=1e-9)
    assert_allclose(after.outer[:, 0] - before.outer[:, 0], off[:3], atol=1e-9)
    assert_allclose(after.weights[:, 1:], before.weights[:, 1:], atol=1e-9)
    assert_allclose(after.left, before.left, atol=1e-12)
