"""A fit that starts from what instruments have in common, and needs a minute of recording for the rest.

The first seconds of a recording are hard to read: where in its play each cable rests is unknown until it has been
drawn through all of it, and offsets look like slack. So the fit tries where the cables may have started, and weighs
each start by how well it explains what was measured.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from trocar.calibration.fleet.loop_fit import DRIFT, outer_features
from trocar.calibration.fleet.loops import FEATURES, MULTIPLES, LoopShape
from trocar.calibration.fleet.prior import FleetPrior
from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.models.drift import DriftWhitener
from trocar.calibration.models.play import RADII_RAD, PlayModel, fit_wrist, with_spectrum, wrist_features
from trocar.calibration.models.play_map import PlayMap
from trocar.calibration.plant import WRIST, fit_plant
from trocar.calibration.recording import Recording

STARTS = np.linspace(-1.0, 1.0, 5)
"""Slacks that are tried before the first command, in shares of a radius; of roll every other one."""
TRIED = np.array(list(product((0, 2, 4), range(5), range(5))))
"""(s, 3) numbers of the starts of roll, pitch, yaw that are tried together."""
SHAPE_ROWS = 400
"""With more rows, radii and coupling are those that fit best by themselves."""
SEARCH = {"maxiter": 250, "xatol": 1e-2, "fatol": 0.1}
"""Of the simplex: radii to a hundredth of themselves, a tenth of a unit of log likelihood."""
FIRST_STEP = 0.7
"""Of the search, in SDs of the prior."""
OWN_ROWS = 200
"""With fewer rows, what the prior has no word for is not looked for."""
ENOUGH_ROWS = 600
"""With so many rows, eight minutes on the robot, a recording speaks for itself: on five of them a fit without a prior
was by then as often better as worse on their last fifth."""
HELD_SHARE = 0.3
"""Of the rows, the last ones, on which it is tried whether that predicts better."""
SHARPNESS = 4
"""Power of the ratio of the squared errors there, by which the two are mixed: half as large counts 16 times as much."""


def fit_from_prior(recording: Recording, prior: FleetPrior) -> PlayModel:
    """Return the play model of an instrument, from a prior and a recording that may be short.

    From ``OWN_ROWS`` on, a map of the instrument's own, fitted without the prior, is mixed in as far as it predicted
    the last part of the recording better; from ``ENOUGH_ROWS`` on, the prior is left out.

    Raises:
        TrocarError: the recording has too few valid rows.
    """
    training = TrainingMotion.of(recording)
    if training.rows >= ENOUGH_ROWS:
        return PlayModel.fit(recording, np.random.default_rng(0))  # which draws nothing
    shape = _shape(recording, prior)
    weights = _weights(recording, shape, prior)
    outer = _outer(recording, prior)
    if training.rows < OWN_ROWS:
        offset = np.concatenate([outer[:, 0], weights[:, 0]])
        return PlayModel(shape.a, shape.b, shape.banks, offset, outer[:, 1:], _without_bumps(weights[:, 1:]), training)
    share = _share(recording, shape, prior)
    radii = with_spectrum(shape.radii)
    own, constant = fit_wrist(recording, shape.a, shape.b, radii)
    mixed = _mixed(weights[:, 1:], own, share)
    offset = np.concatenate([outer[:, 0], share * weights[:, 0] + (1.0 - share) * constant])
    radii = np.concatenate([shape.banks, radii], axis=1)
    return PlayModel(shape.a, shape.b, radii, offset, outer[:, 1:], mixed, training)


def _shape(recording: Recording, prior: FleetPrior) -> LoopShape:
    """Return the most likely radii and coupling."""
    if recording.valid.sum() > SHAPE_ROWS:
        plant = fit_plant(recording)
        return LoopShape(plant.radii, plant.a, plant.b)

    def cost(theta: NDArray[np.float64]) -> float:
        likely, _ = _explained(recording, LoopShape.of(theta), prior)
        most = likely.max()
        away = (theta - prior.shape_mean) / prior.shape_sd
        return float(0.5 * away @ away - most - np.log(np.mean(np.exp(likely - most))))

    simplex = np.vstack([prior.shape_mean, prior.shape_mean + FIRST_STEP * np.diag(prior.shape_sd)])
    options = SEARCH | {"initial_simplex": simplex}
    return LoopShape.of(minimize(cost, prior.shape_mean, method="Nelder-Mead", options=options).x)


def _weights(recording: Recording, shape: LoopShape, prior: FleetPrior) -> NDArray[np.float64]:
    """Return the expected weights (3, FEATURES), all starts weighed by how likely they are."""
    likely, weights = _explained(recording, shape, prior)
    share = np.exp(likely - likely.max())
    return np.einsum("s,sjf->jf", share / share.sum(), weights)


def _explained(
    recording: Recording, shape: LoopShape, prior: FleetPrior
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each start (s,) the log likelihood of the measurements, and the expected weights (s, 3, FEATURES).

    Linear regression with a normal prior, in the coordinates in which that is a standard one.
    """
    q, valid = recording.q_cmd, recording.valid
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    error = whiten((recording.q_phy - q)[valid][:, WRIST])
    slacks = shape.slacks(q, STARTS)[valid]
    rows, k = len(slacks), len(MULTIPLES)
    slacks = whiten(slacks.reshape(rows, -1)).reshape(slacks.shape)
    x = np.empty((len(TRIED), rows, FEATURES))
    x[:, :, :4] = whiten(np.column_stack([np.ones(rows), q[valid][:, WRIST]]))
    for joint in range(3):
        x[:, :, 4 + k * joint : 4 + k * (joint + 1)] = slacks[:, joint][:, TRIED[:, joint]].transpose(1, 0, 2)
    products = x.transpose(0, 2, 1) @ x
    likely, weights = np.zeros(len(TRIED)), np.empty((len(TRIED), 3, FEATURES))
    for joint, (mean, factor, sd) in enumerate(zip(prior.weights, prior.factors, prior.noise_sd, strict=True)):
        away = error[:, joint] - x @ mean
        normal = np.eye(FEATURES) + factor.T @ products @ factor / sd**2
        pull = np.einsum("snf,sn->sf", x, away) @ factor / sd**2
        found = np.linalg.solve(normal, pull[..., None])[..., 0]
        likely += 0.5 * ((pull * found).sum(axis=1) - (away**2).sum(axis=1) / sd**2 - np.linalg.slogdet(normal)[1])
        weights[:, joint] = mean + found @ factor.T
    return likely, weights


def _outer(recording: Recording, prior: FleetPrior) -> NDArray[np.float64]:
    """Return the maps (3, 7) from 1 and the command to the errors of q1 q2 q3."""
    valid = recording.valid
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    x = whiten(outer_features(recording.q_cmd)[valid])
    error = whiten((recording.q_phy - recording.q_cmd)[valid][:, :3])
    return np.array(
        [
            np.linalg.solve(x.T @ x + np.diag((noise / sd) ** 2), x.T @ y)
            for y, sd, noise in zip(error.T, prior.outer_sd, prior.outer_noise_sd, strict=True)
        ]
    )


def _share(recording: Recording, shape: LoopShape, prior: FleetPrior) -> NDArray[np.float64]:
    """Return how much (3,) the prior's map counts beside the instrument's own, by what both predict."""
    good = np.flatnonzero(recording.valid)
    cut = int(good[int((1.0 - HELD_SHARE) * len(good))])
    first, held = recording.first(cut), recording.scored(cut).valid
    q = recording.q_cmd
    true = (recording.q_phy - q)[held][:, WRIST]
    radii = with_spectrum(shape.radii)
    own, constant = fit_wrist(first, shape.a, shape.b, radii)
    ours = np.mean((own(wrist_features(q, shape.a, shape.b, radii)[held]) + constant - true) ** 2, axis=0)
    priors = np.mean((shape.features(q)[held] @ _weights(first, shape, prior).T - true) ** 2, axis=0)
    return 1.0 / (1.0 + (priors / ours) ** SHARPNESS)


def _without_bumps(linear: NDArray[np.float64]) -> PlayMap:
    inputs = np.arange(3)
    return PlayMap(linear, inputs, np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))


def _mixed(linear: NDArray[np.float64], own: PlayMap, share: NDArray[np.float64]) -> PlayMap:
    """Return the mean of two maps, of which the prior's counts ``share`` (3,).

    Its inputs are the slacks of both: of each joint those of the prior's radii first, then those of ``own``.
    """
    few, many = len(MULTIPLES), 1 + len(RADII_RAD)
    ours, theirs = (1.0 - share)[:, None] * own.linear, share[:, None] * linear
    slacks = [theirs[:, 3:].reshape(3, 3, few), ours[:, 3:].reshape(3, 3, many)]
    both = np.concatenate([ours[:, :3] + theirs[:, :3], np.concatenate(slacks, axis=2).reshape(3, -1)], axis=1)
    inputs = own.inputs.copy()
    joint, column = np.divmod(inputs[3:] - 3, many)
    inputs[3:] = 3 + (few + many) * joint + few + column
    return PlayMap(both, inputs, own.mean, own.scale, own.centres, (1.0 - share)[:, None] * own.bumps)
