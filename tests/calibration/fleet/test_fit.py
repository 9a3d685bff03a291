"""Fits that start from a prior, beside dense Bayesian regression."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.special import logsumexp

from fleets import SHAPE, fleet, slack_recording
from trocar.calibration.excitation import PSM1_BOX
from trocar.calibration.fleet import fit, load_prior
from trocar.calibration.fleet.fit import ENOUGH_ROWS, OWN_ROWS, Learned, expected, fit_from_prior, learn_from
from trocar.calibration.fleet.prior import FEATURES, LoopShape
from trocar.calibration.models.play import PlayModel, with_spectrum, wrist_features
from trocar.calibration.models.play_map import DRIFT_ROWS, PlayMap
from trocar.calibration.plant import PSM1_GREY, play_slacks
from trocar.calibration.recording import Recording, load_recording
from walks import walk

STARTS = list(product((-1.0, 0.0, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0)))
"""Slacks that are tried at the start, in shares of a radius: of roll fewer, for its play is the narrowest."""


@pytest.fixture(scope="module")
def prior():
    return fleet()


def alike(recording):
    """Return the covariance of a measurement's errors over the rows, about their variance: noise and drift of .3."""
    rows = np.flatnonzero(recording.valid)
    return np.eye(len(rows)) + 0.3 * np.exp(-np.abs(rows[:, None] - rows) / DRIFT_ROWS)


def features(recording, start):
    banks = SHAPE.banks
    slacks = play_slacks(recording.q_cmd, SHAPE.a, SHAPE.b, banks, np.asarray(start)[:, None] * banks)
    n = len(slacks)
    return np.column_stack([np.ones(n), recording.q_cmd[:, 3:], slacks.reshape(n, -1)])[recording.valid]


def dense(recording, prior, start, joint, noise):
    """Return log likelihood, mean and covariance of a joint's weights by the textbook; noise (n, n) of its errors."""
    x, covariance = features(recording, start), prior.factors[joint] @ prior.factors[joint].T
    away = (recording.q_phy - recording.q_cmd)[recording.valid, 3 + joint] - x @ prior.weights[joint]
    total = noise + x @ covariance @ x.T
    gain = covariance @ x.T @ np.linalg.inv(total)
    likely = -0.5 * (away @ np.linalg.solve(total, away) + np.linalg.slogdet(total)[1] - np.linalg.slogdet(noise)[1])
    return likely, prior.weights[joint] + gain @ away, covariance - gain @ x @ covariance


SOME = [0, 7, 31, 62, 74]


@pytest.mark.parametrize("worse", [False, True])
def test_each_start_is_weighed_as_bayes_says(prior, worse):
    recording = slack_recording(prior, 25, (0.2, -0.7, 0.4), noise=0.02)
    sd_rad = np.random.default_rng(3).uniform(0.0, 0.05, (25, 3)) if worse else None
    found = fit._explained(recording, SHAPE, prior, sd_rad)
    assert found.likely.shape == (len(STARTS),)
    for number in SOME:
        likely = 0.0
        for joint in range(3):
            factor = prior.noise_sd[joint] * np.linalg.cholesky(alike(recording))
            worse_by = 0.0 if sd_rad is None else (sd_rad[recording.valid, joint] / prior.noise_sd[joint]) ** 2
            noise = factor * (1.0 + worse_by) @ factor.T
            one, mean, covariance = dense(recording, prior, STARTS[number], joint, noise)
            likely += one
            assert_allclose(found.weights[number, joint], mean, atol=1e-8)
            root = prior.factors[joint]
            assert_allclose(root @ np.linalg.inv(found.normal[number, joint]) @ root.T, covariance, atol=1e-10)
        assert found.likely[number] == pytest.approx(likely, rel=1e-7)


@pytest.mark.parametrize("start", [(1.0, -0.5, 0.5), (-1.0, 1.0, -1.0), (0.0, 0.0, 0.5)])
def test_where_the_cables_started_is_found(prior, start):
    found = fit._explained(slack_recording(prior, 40, start, seed=4), SHAPE, prior)
    assert STARTS[found.likely.argmax()] == start
    assert_allclose(found.weights[found.likely.argmax()], prior.weights, atol=0.02)


def test_weights_are_the_mean_over_all_starts():
    rng = np.random.default_rng(0)
    likely, weights = np.append(rng.normal(size=74), -2000.0) - 1000.0, rng.normal(size=(75, 3, FEATURES))
    share = np.exp(likely - logsumexp(likely))
    assert_allclose(fit._Explained(likely, weights, None).expected, np.tensordot(share, weights, 1))


def test_before_any_recording_the_fleets_mean_is_expected(prior):
    model, q = expected(prior, PSM1_BOX), 0.5 * walk(0, 30)
    shape = LoopShape.of(prior.shape_mean)
    assert_allclose((model.predict(q) - q)[:, 3:], shape.features(q) @ prior.weights.T, atol=1e-12)
    assert_allclose(model.predict(q)[:, :3], q[:, :3])
    assert model.training.rows == 0
    again = PlayModel.from_arrays(model.arrays(), model.training)
    assert_allclose(again.predict(q), model.predict(q))
    for key, value in (("interval", PSM1_BOX.step), ("lower", PSM1_BOX.lower), ("upper", PSM1_BOX.upper)):
        assert_allclose(getattr(model.training, key), value)


def test_what_is_learned_is_the_textbooks_posterior(prior, monkeypatch):
    monkeypatch.setattr(fit, "_shape", lambda *_: SHAPE)
    recording = slack_recording(prior, 60, (0.0, 0.0, 0.0), noise=0.003)
    learned, explained = learn_from(recording, prior), fit._explained(recording, SHAPE, prior)
    q = 0.5 * walk(5, 30)
    assert_allclose((learned.model.predict(q) - q)[:, 3:], SHAPE.features(q) @ explained.expected.T, atol=1e-12)
    likeliest = STARTS[explained.likely.argmax()]
    for joint in range(3):
        _, _, covariance = dense(recording, prior, likeliest, joint, prior.noise_sd[joint] ** 2 * alike(recording))
        assert_allclose(learned.covariance[joint], covariance, atol=1e-9)
    # A single measurement has noise and drift.
    assert_allclose(learned.left_sd, prior.noise_sd * np.sqrt(alike(recording)[0, 0]))


def test_the_errors_of_the_outer_joints_are_ridge_regressions_in_units_of_the_prior(prior, monkeypatch):
    monkeypatch.setattr(fit, "_shape", lambda *_: SHAPE)
    recording = slack_recording(prior, 60, (0.0, 0.0, 0.0), noise=0.003)
    model = learn_from(recording, prior).model
    x = np.column_stack([np.ones(60), recording.q_cmd])[recording.valid]
    for joint in range(3):
        y = (recording.q_phy - recording.q_cmd)[recording.valid, joint]
        noise = prior.outer_noise_sd[joint] ** 2 * alike(recording)
        precision = np.diag(prior.outer_sd[joint] ** -2.0) + x.T @ np.linalg.solve(noise, x)
        weights = np.linalg.solve(precision, x.T @ np.linalg.solve(noise, y))
        assert_allclose([model.offset[joint], *model.outer[joint]], weights, rtol=1e-6, atol=1e-12)


def test_the_spread_is_what_is_not_known_of_the_weights_and_what_they_leave():
    model = expected(fleet(), PSM1_BOX)
    rng = np.random.default_rng(0)
    roots = rng.normal(0, 0.1, (3, FEATURES, FEATURES))
    learned = Learned(model, roots @ roots.transpose(0, 2, 1), np.array([0.1, 0.2, 0.3]))
    q = 0.5 * walk(1, 20)
    state = model.start(q[0])
    for row in q:
        _, state = model.step(state, row)
    x = LoopShape(model.radii[:, 1], model.a, model.b).features(q)[-1]
    for joint, spread in enumerate(learned.spread(state, q[-1]) / fit.WIDER):
        assert spread == pytest.approx(np.hypot(np.linalg.norm(x @ roots[joint]), 0.1 * (joint + 1)))


@pytest.mark.parametrize("far", [0.0, 1.0, 2000.0])
def test_the_shape_is_the_most_likely_one_given_the_prior(prior, monkeypatch, far):
    """Some starts, whose likelihoods count together; each says something else about the shape, and none much."""
    rng = np.random.default_rng(0)
    tops = prior.shape_mean + 1.5 * rng.normal(size=(5, 5)) * prior.shape_sd
    likely = -40.0 - np.array([0.0, far, far, far, far])

    def explained(recording, shape, prior, sd_rad):
        away = (shape.theta - tops) / prior.shape_sd
        return fit._Explained(likely - 0.3 * np.sum(away**2, axis=1), None, None)

    def cost(theta):
        away = (theta - prior.shape_mean) / prior.shape_sd
        return 0.5 * away @ away - logsumexp(explained(None, LoopShape.of(theta), prior, None).likely)

    monkeypatch.setattr(fit, "_explained", explained)
    found = fit._shape(slack_recording(prior, 40, np.zeros(3)), prior).theta
    best = min((minimize(cost, top) for top in tops), key=lambda one: one.fun)
    assert cost(found) < best.fun + 0.03


def test_many_rows_show_their_shape_by_themselves(prior, monkeypatch):
    monkeypatch.setattr(fit, "fit_plant", lambda recording: PSM1_GREY)
    monkeypatch.setattr(fit, "_explained", lambda recording, shape, *_: fit._Explained(np.zeros(75), None, None))
    found = {}
    for rows in (400, 401):
        q = walk(0, rows)
        found[rows] = fit._shape(Recording(q, q, np.ones(rows, bool), np.arange(float(rows))), prior)
    assert_allclose(found[400].theta, prior.shape_mean, atol=0.1)
    assert_allclose(found[401].theta, [*np.log(PSM1_GREY.radii), PSM1_GREY.a, PSM1_GREY.b])


def test_a_few_rows_are_left_to_the_prior_and_many_do_without(prior, monkeypatch):
    """In between, the prior's map and the instrument's own are mixed."""
    monkeypatch.setattr(fit, "learn_from", lambda recording, prior: Learned("prior", None, None))
    monkeypatch.setattr(fit.PlayModel, "fit", lambda recording, rng: "own")
    monkeypatch.setattr(fit, "_shape", lambda *_: SHAPE)
    monkeypatch.setattr(fit, "_share", lambda *_: np.array([0.0, 0.5, 1.0]))
    q = 0.5 * walk(0, ENOUGH_ROWS)
    recording = Recording(q, q + 0.01 + 0.1 * q[:, ::-1], np.ones(len(q), bool), np.arange(float(len(q))))
    assert OWN_ROWS < ENOUGH_ROWS
    assert fit_from_prior(recording.first(OWN_ROWS - 1), prior) == "prior"
    assert fit_from_prior(recording, prior) == "own"
    monkeypatch.undo()
    monkeypatch.setattr(fit, "_shape", lambda *_: SHAPE)
    monkeypatch.setattr(fit, "_share", lambda *_: np.array([0.0, 0.5, 1.0]))
    linear = np.random.default_rng(0).normal(0, 0.1, (3, 3 + 3 * 9))
    own = PlayMap(linear, np.arange(3), np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))
    monkeypatch.setattr(fit, "fit_wrist", lambda *_: (own, np.array([0.1, 0.2, 0.3])))
    part = recording.first(OWN_ROWS)
    model = fit_from_prior(part, prior)
    outer = fit._outer(part, prior)
    assert_allclose(model.predict(q)[:, :3] - q[:, :3], outer[:, 0] + q @ outer[:, 1:].T, atol=1e-12)
    error = model.predict(q)[:, 3:] - q[:, 3:]
    alone = own(wrist_features(q, SHAPE.a, SHAPE.b, with_spectrum(SHAPE.radii))) + [0.1, 0.2, 0.3]
    whole = SHAPE.features(q) @ fit._explained(part, SHAPE, prior).expected.T
    assert_allclose(error, [1.0, 0.5, 0.0] * alone + [0.0, 0.5, 1.0] * whole, atol=1e-12)


def test_a_mixed_map_is_the_mean_of_both():
    rng = np.random.default_rng(0)
    linear, share = rng.normal(size=(3, FEATURES - 1)), np.array([0.2, 0.5, 0.9])
    own = PlayMap(
        *(rng.normal(size=(3, 30)), np.array([0, 1, 2, 4, 14, 21]), rng.normal(size=6), rng.uniform(1, 2, 6)),
        *(rng.normal(size=(4, 6)), rng.normal(size=(3, 4))),
    )
    q = 0.5 * walk(2, 20)
    radii = with_spectrum(SHAPE.radii)
    both = wrist_features(q, SHAPE.a, SHAPE.b, np.concatenate([SHAPE.banks, radii], axis=1))
    mixed = fit._mixed(linear, own, share)(both)
    ours = own(wrist_features(q, SHAPE.a, SHAPE.b, radii))
    assert_allclose(mixed, (1.0 - share) * ours + share * (SHAPE.features(q)[:, 1:] @ linear.T), atol=1e-12)


def test_each_joint_is_left_to_the_map_that_predicts_it_better(prior, monkeypatch):
    """On rows that neither has seen, the last three tenths; half the squared error counts sixteen times as much."""
    q, e = 0.5 * walk(0, 220), np.array([0.3, 0.2, 0.1])
    valid = np.arange(220) >= 20
    held = np.arange(220) >= 20 + 140
    q_phy = q.copy()
    uneven = np.where(np.arange(220) % 4 > 0, 0.0, 0.05)[:, None]
    q_phy[:, 3:] += np.where(held[:, None], e, -0.9) + uneven
    recording = Recording(q, q_phy, valid, np.arange(220.0))
    seen, ours = [], 0.02 * np.array([1.0, 1.0, -np.sqrt(2.0)])
    nothing = PlayMap(np.zeros((3, 30)), np.arange(3), np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))

    def fit_wrist(part, a, b, radii):
        seen.append(len(part))
        return nothing, e + ours

    def explained(part, shape, prior):
        seen.append(len(part))
        found = np.zeros((3, FEATURES))
        found[:, 0] = e - 0.02 * np.array([1.0, np.sqrt(2.0), 1.0])
        return SimpleNamespace(expected=found)

    monkeypatch.setattr(fit, "fit_wrist", fit_wrist)
    monkeypatch.setattr(fit, "_explained", explained)
    share = fit._share(recording, SHAPE, prior)
    assert seen == [160, 160]
    own, theirs = ours - uneven[held], -0.02 * np.array([1.0, np.sqrt(2.0), 1.0]) - uneven[held]
    ratio = np.mean(theirs**2, axis=0) / np.mean(own**2, axis=0)
    assert_allclose(share, 1.0 / (1.0 + ratio**4))


def test_errors_are_as_wide_as_they_are_told_to_be(recordings, monkeypatch):
    """On instruments that the prior never saw, of which half a minute and their loops' shape are known."""
    built_in, squares = load_prior("fleet"), []
    for name, instrument in (("psm2_grey_random", "psm2"), ("psm1_new_random", "psm1_new")):
        shape = next(one.shape for one in built_in.fits if one.name == name)
        monkeypatch.setattr(fit, "_shape", lambda *_, shape=shape: LoopShape.of(shape))
        data = load_recording(recordings / f"dvrk/trajectories/{name}.npz").first(400)
        learned = learn_from(data.first(50), built_in.without(instrument))
        state = learned.model.start(data.q_cmd[0])
        for row, q in enumerate(data.q_cmd):
            joints, state = learned.model.step(state, q)
            if row > 50 and data.valid[row]:
                squares.append(((data.q_phy[row] - joints)[3:] / learned.spread(state, q)) ** 2)
    ratio = np.sqrt(np.mean(squares, axis=0))
    assert (ratio > 0.45).all() and (ratio < 1.1).all(), ratio
