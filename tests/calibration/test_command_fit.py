from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from plant_models import HOME, recorded
from trocar.arms import ARMS, MOTION_LIMITS, jacobian
from trocar.calibration import command_fit
from trocar.calibration.command_fit import EASE, LEVER, CommandFit
from trocar.calibration.compensation import HysteresisState
from trocar.calibration.limited_paths import LimitedPaths, QuadraticSpline
from trocar.calibration.models import MODELS, OffsetModel
from trocar.calibration.plant import PLANTS, WRIST

PAPER = MOTION_LIMITS["paper"]


@pytest.fixture(scope="module")
def fit():
    """A wrist that goes to and fro: operators stay behind at knots and at turns between them."""
    arm, rng, plant = ARMS["psm-classic"], np.random.default_rng(0), PLANTS["psm2_grey"]
    recording = recorded(plant, rng, 400)
    times = np.linspace(0.0, 1.2, 41)
    spline = QuadraticSpline(times)
    paths = LimitedPaths(spline, HOME, np.zeros(6), PAPER, arm.lower, arm.upper, np.full(41, 0.03))
    swing = np.array([0.02, 0.01, 0.005, 0.25, 0.2, -0.2])
    wanted = HOME + [0, 0, 0, 0.2, -0.1, 0.1] + np.sin(7.3 * times + 0.2)[:, None] * swing
    return CommandFit(paths, HysteresisState.at_rest(MODELS["play"].fit(recording, rng), HOME), wanted)


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


def test_levers_are_how_far_a_joint_moves_the_tip():
    """In units of the wrist's 15 mm; the tip of a bent wrist is a centimetre off the axis of roll."""
    arm = ARMS["psm-classic"]
    q = (arm.lower + arm.upper) / 2
    q[2], q[4], q[5] = 0.15, 0.6, 0.0
    moves = np.linalg.norm(jacobian(arm, q)[:3], axis=0)
    assert (0.6 * moves < LEVER * 0.015).all() and (1.6 * moves > LEVER * 0.015).all()
    assert_allclose(EASE * LEVER * 0.015, 25e-6, atol=16e-6)


def test_the_end_error_is_the_farthest_that_a_joint_moves_the_tip(fit):
    fitted = fit.predict(fit.nearest(fit.wanted))
    error = np.zeros_like(fitted.error)
    error[0], error[-1] = 1.0, [0.001, -0.002, 0.0001, 0.01, -0.03, 0.02]
    assert replace(fitted, error=error).end_error == pytest.approx(0.03)
    error[-1, 1] = -0.004
    assert replace(fitted, error=error).end_error == pytest.approx(0.04)
    error[-1, 2] = 0.001
    assert replace(fitted, error=error).end_error == pytest.approx(0.067)


def test_the_nearest_path_weighs_errors_by_levers_and_spares_full_acceleration(fit, monkeypatch):
    """No other path is better in the sum of both, each as it is told; from a start in motion."""
    monkeypatch.setattr(command_fit, "EASE", 1e4 * EASE)
    limits = type(PAPER)(1e3 * PAPER.velocity, 1e3 * PAPER.acceleration)
    slow = replace(fit.paths, velocity_start=0.2 * PAPER.velocity, limits=limits)
    loose = CommandFit(slow, fit.memory, fit.wanted)
    x = loose.nearest(fit.wanted)

    def cost(x):
        path = slow.spline.trajectory(slow.points(x))
        times = slow.spline.times_s
        error, push = path(times) - fit.wanted, path((times[1:] + times[:-1]) / 2, 2)
        near = np.sum(slow.weights_s[:, None] * (LEVER * error) ** 2)
        return near + np.sum(np.diff(times)[:, None] * (LEVER * 1e4 * EASE * push / slow.limits.acceleration) ** 2)

    rng, least = np.random.default_rng(0), cost(x)
    for _ in range(20):
        step = rng.normal(0, 1e-4, x.shape)
        assert cost(x + step) > least and cost(x - step) > least
        slope = (cost(x + step) - cost(x - step)) / 2
        assert abs(slope) < 1e-3 * (cost(x + step) - least)


def test_joints_are_predicted_through_all_turns_between_the_knots(fit):
    fitted = fit.predict(fit.nearest(fit.wanted))
    path, model = fit.paths.spline.trajectory(fit.paths.points(fitted.x)), fit.memory.model
    times = fit.paths.spline.times_s
    assert np.any((fitted.turns_s > 1e-4) & (fitted.turns_s < fit.paths.spline.steps_s[:, None] - 1e-4))
    for knot in (5, 17, 29, 40):
        dense = path(np.linspace(0.0, times[knot], 40 * knot + 1))
        state = model.remember(fit.memory.state, dense)
        assert_allclose(fitted.q_cmd[knot], path(times[knot]), atol=1e-12)
        assert_allclose(fit.wanted[knot] - fitted.error[knot], model.step(state, fitted.q_cmd[knot])[0], atol=2e-5)
    squares = fit.paths.weights_s[:, None] * (LEVER * fitted.error) ** 2
    assert fitted.cost == pytest.approx(squares.sum())


def test_an_input_turns_where_its_speed_is_zero_or_at_an_end(fit):
    fitted = fit.predict(fit.nearest(fit.wanted))
    path = fit.paths.spline.trajectory(fit.paths.points(fitted.x))
    starts, steps = fit.paths.spline.times_s[:-1], fit.paths.spline.steps_s
    for interval in range(len(steps)):
        for j in range(3):
            turn = fitted.turns_s[interval, j]
            at = fit.memory.model.inputs(path(starts[interval] + np.array([1e-9, turn, steps[interval] - 1e-9]), 1))[
                :, j
            ]
            if 0.0 < turn < steps[interval]:
                assert abs(at[1]) < 1e-6
            else:
                assert at[0] * at[2] > -1e-9


def test_other_models_are_asked_command_after_command(fit):
    offset = OffsetModel(np.linspace(0.01, 0.06, 6), fit.memory.model.training)
    other = CommandFit(fit.paths, HysteresisState.at_rest(offset, HOME), fit.wanted)
    fitted = other.predict(other.nearest(fit.wanted))
    assert fitted.response is None and fitted.turns_s.shape == (40, 3) and not fitted.turns_s.any()
    assert_allclose(fitted.error, fit.wanted - fitted.q_cmd - np.linspace(0.01, 0.06, 6), atol=1e-12)


def test_a_step_is_taken_as_far_as_it_helps_and_refinement_ends_where_none_does(fit, monkeypatch):
    roughly = fit.predict(fit.nearest(fit.wanted))
    costs = []
    step = CommandFit._step

    def seen(self, fitted):
        better = step(self, fitted)
        costs.append((fitted.cost, None if better is None else better.cost))
        return better

    monkeypatch.setattr(CommandFit, "_step", seen)
    refined = fit.refine(roughly)
    assert 1 <= len(costs) <= 5
    assert costs[0][0] == roughly.cost
    assert all(after is None or after < before for before, after in costs)
    assert refined.cost == min(after for _, after in costs if after is not None)
    # Near its optimum a path cannot be made much better by any small change that the limits allow.
    costs.clear()
    again = fit.refine(refined)
    assert again.cost > 0.8 * refined.cost


def test_refinement_ends_once_the_end_is_met_and_little_is_gained(fit, monkeypatch):
    start = fit.predict(fit.nearest(fit.wanted))
    met, missed = np.zeros_like(start.error), np.zeros_like(start.error)
    missed[-1] = 1e-4
    for error, shares, steps in (
        (met, (0.5, 0.69, 0.71, 0.9), 3),
        (missed, (0.5, 0.69, 0.71, 0.9, 0.9, 0.9), 5),
        (met, (0.5,) * 6, 5),
        (met, (0.5, None), 2),
    ):
        left, taken = list(shares), []

        def step(self, fitted, left=left, taken=taken, error=error):
            share = left.pop(0)
            taken.append(share)
            return None if share is None else replace(fitted, cost=share * fitted.cost, error=error)

        monkeypatch.setattr(CommandFit, "_step", step)
        found = fit.refine(replace(start, cost=1.0, error=error))
        assert len(taken) == steps
        assert found.cost == pytest.approx(np.prod([share for share in taken if share]))


def test_a_share_of_a_taut_cables_response_is_taken_for_granted(fit, monkeypatch):
    """At all knots but the last: if all commands go on by as much, the joints of a taut cable follow as it says."""
    fitted = fit.predict(fit.nearest(fit.wanted))
    slopes = {}
    for share in (0.0, command_fit.TAUT, 1.0):
        monkeypatch.setattr(command_fit, "TAUT", share)
        slopes[share] = fit._slopes(fitted).toarray().reshape(len(fit.wanted), 3, 6, -1).sum(axis=3)[2:, :, 3:]
    slack, some, taut = slopes.values()
    expected = (fitted.response.taut - fitted.response.by_command)[2:]
    assert np.abs(expected[:-1]).max() > 0.1
    assert_allclose((taut - slack)[:-1], expected[:-1], atol=1e-9)
    assert_allclose(some - slack, 0.15 * (taut - slack), atol=1e-9)
    assert not (taut - slack)[-1].any()


def test_a_step_minimises_what_is_expected_to_be_left(fit, monkeypatch):
    """Errors of the wrist as the slopes say, of the outer joints as their commands go, and the two penalties."""
    monkeypatch.setattr(command_fit, "EASE", 300 * EASE)
    free = CommandFit(replace(fit.paths, velocity_start=0.1 * PAPER.velocity), fit.memory, fit.wanted)
    fitted, found = free.predict(free.nearest(free.wanted)), []

    def solve(self, hessian, gradient):
        x = np.linalg.solve(hessian.toarray(), -gradient.T.ravel()).reshape(6, -1).T
        found.append(x)
        return x

    monkeypatch.setattr(LimitedPaths, "solve", solve)
    free._step(fitted)
    slopes, spline = free._slopes(fitted).toarray(), free.paths.spline
    weights, ease = free.paths.weights_s[:, None], (LEVER * 300 * EASE / PAPER.acceleration) ** 2

    def left(x):
        path = spline.trajectory(free.paths.points(x))
        on = path(spline.times_s) - fitted.q_cmd
        wrist = fitted.error[:, WRIST] - (slopes @ (x - fitted.x).T.ravel()).reshape(-1, 3)
        outer = LEVER[:3] * (fitted.error - on)[:, :3]
        push = path((spline.times_s[1:] + spline.times_s[:-1]) / 2, 2)
        damped = np.sum(weights * wrist**2) + np.sum(weights * outer**2) + 0.03**2 * np.sum(weights * on[:, WRIST] ** 2)
        return damped + np.sum(spline.steps_s[:, None] * ease * push**2)

    rng, least = np.random.default_rng(0), left(found[0])
    for joint in range(6):
        step = rng.normal(0, 1e-3, fitted.x.shape) * (np.arange(6) == joint)
        ahead, behind = left(found[0] + step) - least, left(found[0] - step) - least
        assert ahead > 0 and behind > 0
        assert abs(ahead - behind) < 1e-3 * (ahead + behind)
