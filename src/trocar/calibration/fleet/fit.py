"""Fits of the play model that start from the fleet prior, so that a minute of recording is enough.

The first seconds of a recording are ambiguous: where in its play a cable rests is unknown until the cable has been
pulled through all of it, and until then an offset looks like slack. So the fit tries several initial states of the
cables and weights each by how well it explains the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from trocar.calibration.excitation import MotionBox
from trocar.calibration.fleet.prior import DRIFT, FEATURES, MULTIPLES, FleetPrior, LoopShape, outer_features
from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.models.play import RADII_RAD, PlayBank, PlayModel, fit_wrist, with_spectrum, wrist_features
from trocar.calibration.models.play_map import DriftWhitener, PlayMap
from trocar.calibration.plant import WRIST, fit_plant
from trocar.calibration.recording import Recording
from trocar.geometry.arrays import Array

STARTS = np.linspace(-1.0, 1.0, 5)
"""Slacks that are tried before the first command, as shares of a radius; for roll, every other one."""
TRIED = np.array(list(product((0, 2, 4), range(5), range(5))))
"""(s, 3) indices of the initial slacks of roll, pitch and yaw that are tried together."""
SHAPE_ROWS = 400  # with more rows than this, radii and coupling are those that fit best, without the prior
SEARCH = {"maxiter": 250, "xatol": 1e-2, "fatol": 0.1}
"""Settings of the simplex search: radii to one percent, log likelihood to a tenth of a unit."""
FIRST_STEP = 0.7  # first step of the search, in SDs of the prior
OWN_ROWS = 200  # with fewer rows than this, no effects beyond those in the prior are fitted
ENOUGH_ROWS = 600
"""With this many rows, eight minutes on the robot, a recording needs no prior: on the last fifth of five recordings, a
fit without one was better as often as worse."""
HELD_SHARE = 0.3  # share of the rows, at the end, on which the prior's map is compared with the instrument's own
WIDER = np.array([1.4, 2.3, 1.7])
"""Errors of q4 q5 q6 are larger than the regression states by these factors: real loops are not quite of this shape,
and errors drift. Found on six recordings of instruments that the prior never saw, after 50 and 100 rows
(`benchmarks/bench_prior.py`)."""
SHARPNESS = 4
"""The two maps are mixed by the ratio of their squared errors on these rows, raised to this power: a map with half the
squared error counts 16 times as much."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A play model and its uncertainty."""

    model: PlayModel  # the expected one
    covariance: Array  # (3, FEATURES, FEATURES) of the weights of each joint's error
    left_sd: Array  # (3,) SD of the errors that such a map leaves, rad

    def spread(self, state: PlayBank, q_cmd: Array) -> Array:
        """Return the SDs (3,) of the wrist's joints about the model's prediction at a command (6,), rad."""
        slack = self.model.inputs(q_cmd)[:, None] - state
        x = np.concatenate([[1.0], q_cmd[WRIST], slack.ravel()])
        return WIDER * np.sqrt(np.einsum("f,jfg,g->j", x, self.covariance, x) + self.left_sd**2)


def expected(prior: FleetPrior, box: MotionBox) -> PlayModel:
    """Return the play model of an instrument about which only the prior is known, and which moves in a box."""
    shape = LoopShape.of(prior.shape_mean)
    training = TrainingMotion(box.step, box.lower, box.upper, 0)
    offset = np.concatenate([np.zeros(3), prior.weights[:, 0]])
    linear = _without_bumps(prior.weights[:, 1:])
    return PlayModel(shape.a, shape.b, shape.banks, offset, np.zeros((3, 6)), linear, training)


def fit_from_prior(recording: Recording, prior: FleetPrior) -> PlayModel:
    """Return the play model of an instrument, from a prior and a recording that may be short.

    From ``OWN_ROWS`` on, a map fitted to this instrument without the prior is mixed in to the extent that it predicts
    the last part of the recording better; from ``ENOUGH_ROWS`` on, the prior is left out.

    Raises TrocarError: the recording has too few valid rows.
    """
    training = TrainingMotion.of(recording)
    if training.rows >= ENOUGH_ROWS:
        return PlayModel.fit(recording, np.random.default_rng(0))  # this fit draws no numbers
    if training.rows < OWN_ROWS:
        return learn_from(recording, prior).model
    shape = _shape(recording, prior)
    weights = _explained(recording, shape, prior).expected
    outer = _outer(recording, prior)
    share = _share(recording, shape, prior)
    radii = with_spectrum(shape.radii)
    own, constant = fit_wrist(recording, shape.a, shape.b, radii)
    mixed = _mixed(weights[:, 1:], own, share)
    offset = np.concatenate([outer[:, 0], share * weights[:, 0] + (1.0 - share) * constant])
    radii = np.concatenate([shape.banks, radii], axis=1)
    return PlayModel(shape.a, shape.b, radii, offset, outer[:, 1:], mixed, training)


def learn_from(recording: Recording, prior: FleetPrior, sd_rad: Array | None = None) -> Learned:
    """Return the play model of an instrument from a prior and a short recording, with its uncertainty.

    The shape of the loops and the initial state of the cables are set to their most likely values and count as known.

    ``sd_rad`` (n, 3) are SDs of the wrist's measurements, if these are less accurate than those behind the prior.

    Raises TrocarError: the recording has too few valid rows.
    """
    training = TrainingMotion.of(recording)
    shape = _shape(recording, prior, sd_rad)
    explained = _explained(recording, shape, prior, sd_rad)
    weights, outer = explained.expected, _outer(recording, prior)
    offset = np.concatenate([outer[:, 0], weights[:, 0]])
    model = PlayModel(shape.a, shape.b, shape.banks, offset, outer[:, 1:], _without_bumps(weights[:, 1:]), training)
    inverse = np.linalg.inv(explained.normal[explained.likely.argmax()])
    covariance = prior.factors @ inverse @ prior.factors.transpose(0, 2, 1)
    return Learned(model, covariance, prior.noise_sd * np.sqrt(1.0 + DRIFT))


def _shape(recording: Recording, prior: FleetPrior, sd_rad: Array | None = None) -> LoopShape:
    """Return the most likely radii and coupling."""
    if recording.valid.sum() > SHAPE_ROWS:
        plant = fit_plant(recording)
        return LoopShape(plant.radii, plant.a, plant.b)
    from scipy.optimize import minimize  # slow to import, and few callers need it

    def cost(theta: Array) -> float:
        likely = _explained(recording, LoopShape.of(theta), prior, sd_rad).likely
        most = likely.max()
        away = (theta - prior.shape_mean) / prior.shape_sd
        return float(0.5 * away @ away - most - np.log(np.mean(np.exp(likely - most))))

    simplex = np.vstack([prior.shape_mean, prior.shape_mean + FIRST_STEP * np.diag(prior.shape_sd)])
    options = SEARCH | {"initial_simplex": simplex}
    return LoopShape.of(minimize(cost, prior.shape_mean, method="Nelder-Mead", options=options).x)


@dataclass(frozen=True, eq=False)
class _Explained:
    """How well each initial state of the cables explains the measurements."""

    likely: Array  # (s,) log likelihood
    weights: Array  # (s, 3, FEATURES) expected
    # (s, 3, FEATURES, FEATURES) inverse covariance of the weights where the prior's is the identity
    normal: Array

    @property
    def expected(self) -> Array:
        """Return the expected weights (3, FEATURES): the mean over all initial states, weighted by their likelihood."""
        share = np.exp(self.likely - self.likely.max())
        return np.einsum("s,sjf->jf", share / share.sum(), self.weights)


def _explained(recording: Recording, shape: LoopShape, prior: FleetPrior, sd_rad: Array | None = None) -> _Explained:
    """Return how well a shape of loops explains the measurements.

    Linear regression with a normal prior, in coordinates in which the prior is standard normal.
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
    known = np.ones((rows, 3)) if sd_rad is None else 1.0 / (1.0 + (sd_rad[valid] / prior.noise_sd) ** 2)
    likely, weights = np.zeros(len(TRIED)), np.empty((len(TRIED), 3, FEATURES))
    normal = np.empty((len(TRIED), 3, FEATURES, FEATURES))
    for joint, (mean, factor, sd) in enumerate(zip(prior.weights, prior.factors, prior.noise_sd, strict=True)):
        away, weighed = error[:, joint] - x @ mean, x * known[:, joint, None] / sd**2
        normal[:, joint] = np.eye(FEATURES) + factor.T @ (weighed.transpose(0, 2, 1) @ x) @ factor
        pull = np.einsum("snf,sn->sf", weighed, away) @ factor
        found = np.linalg.solve(normal[:, joint], pull[..., None])[..., 0]
        alone = (away**2 @ known[:, joint]) / sd**2
        likely += 0.5 * ((pull * found).sum(axis=1) - alone - np.linalg.slogdet(normal[:, joint])[1])
        weights[:, joint] = mean + found @ factor.T
    return _Explained(likely, weights, normal)


def _outer(recording: Recording, prior: FleetPrior) -> Array:
    """Return the maps (3, 7) from 1 and the command to the errors of q1 q2 q3."""
    valid = recording.valid
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    x = whiten(outer_features(recording.q_cmd)[valid])
    error = whiten(recording.errors[valid][:, :3])
    return np.array(
        [
            np.linalg.solve(x.T @ x + np.diag((noise / sd) ** 2), x.T @ y)
            for y, sd, noise in zip(error.T, prior.outer_sd, prior.outer_noise_sd, strict=True)
        ]
    )


def _share(recording: Recording, shape: LoopShape, prior: FleetPrior) -> Array:
    """Return the weight (3,) of the prior's map against the instrument's own, from how well both predict."""
    good = np.flatnonzero(recording.valid)
    cut = int(good[int((1.0 - HELD_SHARE) * len(good))])
    first, held = recording.first(cut), recording.scored(cut).valid
    q = recording.q_cmd
    true = (recording.q_phy - q)[held][:, WRIST]
    radii = with_spectrum(shape.radii)
    own, constant = fit_wrist(first, shape.a, shape.b, radii)
    ours = np.mean((own(wrist_features(q, shape.a, shape.b, radii)[held]) + constant - true) ** 2, axis=0)
    priors = np.mean((shape.features(q)[held] @ _explained(first, shape, prior).expected.T - true) ** 2, axis=0)
    return 1.0 / (1.0 + (priors / ours) ** SHARPNESS)


def _without_bumps(linear: Array) -> PlayMap:
    inputs = np.arange(3)
    return PlayMap(linear, inputs, np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros((3, 0)))


def _mixed(linear: Array, own: PlayMap, share: Array) -> PlayMap:
    """Return the mean of two maps, with weight ``share`` (3,) for the prior's.

    Its inputs are the slacks of both: for each joint first those of the prior's radii, then those of ``own``.
    """
    few, many = len(MULTIPLES), 1 + len(RADII_RAD)
    ours, theirs = (1.0 - share)[:, None] * own.linear, share[:, None] * linear
    slacks = [theirs[:, 3:].reshape(3, 3, few), ours[:, 3:].reshape(3, 3, many)]
    both = np.concatenate([ours[:, :3] + theirs[:, :3], np.concatenate(slacks, axis=2).reshape(3, -1)], axis=1)
    inputs = own.inputs.copy()
    joint, column = np.divmod(inputs[3:] - 3, many)
    inputs[3:] = 3 + (few + many) * joint + few + column
    return PlayMap(both, inputs, own.mean, own.scale, own.centres, (1.0 - share)[:, None] * own.bumps)
