"""What is known about an instrument's cables before it is measured, from loops of one common shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from trocar.calibration.models.base import shaped
from trocar.calibration.models.play_map import DriftWhitener
from trocar.calibration.plant import WRIST, fit_plant, play_slacks
from trocar.calibration.recording import Recording
from trocar.errors import BadFile, InvalidInput, TrocarError
from trocar.files.archive import Archive, read_archive
from trocar.geometry.arrays import Array

MULTIPLES = np.array([0.4, 1.0, 1.8])
"""Radii of the play operators of a joint, in multiples of its backlash: real loops have round corners."""
FEATURES = 4 + 3 * len(MULTIPLES)
"""Number of inputs of the linear map to the errors of q4 q5 q6: 1, q4, q5, q6, then the slacks of each joint in
turn."""
DRIFT = 0.3  # variance of the drift over that of the noise: the value of ``DRIFT_RATIOS`` that recordings show
RIDGE = np.array([0.0] + [0.05] * 3 + [0.15] * (FEATURES - 4))
"""Penalty on each weight of one recording's map; without it, weights of neighbouring radii could be exchanged
freely."""
OUTER_RIDGE = np.array([0.0] + [1.0] * 6)
FORMAT = "trocar fleet prior"
VERSION = 2
BUILT_IN = "fleet"  # name of the prior that comes with Trocar
_SHAPES = {"shape": ("fits", 5), "weights": ("fits", 3, FEATURES), "outer": ("fits", 3, 7), "left": ("fits", 6)}
"""Shapes of the file's arrays, which hold the fit to each recording."""

LEAST_SHAPE_SD = np.array([0.4, 0.4, 0.4, 0.06, 0.06])
"""Least SD of ``LoopShape.theta``, since half a dozen recordings do not show every instrument; radii within a factor of
1.5."""
OFFSET_SD = 0.15  # least SD of an offset, rad: offsets change whenever an instrument is mounted
OWN_SD = (0.02, 0.05, 0.10)  # least SD of a joint's error per rad of its own command: gain of roll, pitch, yaw
COUPLING_SD = 0.03  # least SD of a joint's error per rad of another one's command
SLACK_SD = 0.06 / np.sqrt(len(MULTIPLES))  # least SD of a joint's error per rad of slack
OUTER_OFFSET_SD = np.array([3e-3, 3e-3, 5e-4])  # least SD of the offsets of q1 q2 q3: rad, rad, m
COMMON = 0.5  # share of the least variances that is added to the variances found over all recordings


@dataclass(frozen=True, eq=False)
class LoopShape:
    """The shape of the wrist's hysteresis loops, without the weights."""

    radii: Array  # (3,) backlash of roll, pitch, yaw, rad
    a: float  # share of yaw in the motion of the pitch cable
    b: float  # share of pitch in the motion of the yaw cable

    @staticmethod
    def of(theta: Array) -> LoopShape:
        """Return the shape with these parameters (5,): logarithms of the radii, a, b."""
        return LoopShape(np.exp(theta[:3]), float(theta[3]), float(theta[4]))

    @property
    def theta(self) -> Array:
        """Return the parameters (5,)."""
        return np.array([*np.log(self.radii), self.a, self.b])

    @property
    def banks(self) -> Array:
        """Return the radii (3, k) of all operators."""
        return self.radii[:, None] * MULTIPLES

    def slacks(self, q_cmd: Array, starts: Array) -> Array:
        """Return the slacks (n, 3, s, k) along commands (n, 6), from ``starts`` (s,): shares of the radii."""
        shape = (3, len(starts), len(MULTIPLES))
        radii = np.broadcast_to(self.banks[:, None], shape)
        slacks = play_slacks(q_cmd, self.a, self.b, radii.reshape(3, -1), (starts[:, None] * radii).reshape(3, -1))
        return slacks.reshape(len(q_cmd), *shape)

    def features(self, q_cmd: Array) -> Array:
        """Return the features (n, FEATURES) along commands (n, 6) that start without slack."""
        slacks = self.slacks(q_cmd, np.zeros(1))
        return np.column_stack([np.ones(len(q_cmd)), q_cmd[:, WRIST], slacks.reshape(len(q_cmd), -1)])


@dataclass(frozen=True, eq=False)
class LoopFit:
    """One recording's loops."""

    name: str  # of the recording
    shape: Array  # (5,) of ``LoopShape.theta``
    weights: Array  # (3, FEATURES) of the map from ``LoopShape.features`` to the errors of q4 q5 q6
    outer: Array  # (3, 7) of the errors of q1 q2 q3 as maps of 1 and the command, rad and m
    left: Array  # (6,) variances of the errors that these maps leave


def outer_features(q_cmd: Array) -> Array:
    """Return the inputs (n, 7) of the linear maps for the errors of q1 q2 q3: 1 and the command."""
    return np.column_stack([np.ones(len(q_cmd)), q_cmd])


def fit_loops(recording: Recording) -> LoopFit:
    """Return the fit to one recording alone."""
    plant, valid = fit_plant(recording), recording.valid
    shape = LoopShape(plant.radii, plant.a, plant.b)
    error = recording.errors[valid]
    whiten = DriftWhitener.of(np.flatnonzero(valid), DRIFT)
    features = shape.features(recording.q_cmd)[valid]
    weights = _ridge(features, error[:, WRIST], RIDGE, whiten)
    outside = outer_features(recording.q_cmd)[valid]
    outer = _ridge(outside, error[:, :3], OUTER_RIDGE, whiten)
    left = np.concatenate([error[:, :3] - outside @ outer.T, error[:, WRIST] - features @ weights.T], axis=1)
    return LoopFit(recording.name, shape.theta, weights, outer, np.mean(whiten(left) ** 2, axis=0))


def _ridge(x: Array, y: Array, penalty: Array, whiten: DriftWhitener) -> Array:
    x, y = whiten(x), whiten(y)
    return np.asarray(np.linalg.solve(x.T @ x + np.diag(penalty), x.T @ y).T, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class FleetPrior:
    """Normal distributions of the parameters of a fit, over instruments and sessions."""

    shape_mean: Array  # (5,) of ``LoopShape.theta``
    shape_sd: Array  # (5,) likewise
    weights: Array  # (3, FEATURES) mean of the map from ``LoopShape.features`` to the errors of q4 q5 q6
    factors: Array  # (3, FEATURES, FEATURES) lower Cholesky factors of its covariance, joint by joint
    noise_sd: Array  # (3,) SD of the errors that such a map leaves, rad
    # (3, 7) SD of the maps from 1 and the command to the errors of q1 q2 q3, whose mean is 0; rad and m
    outer_sd: Array
    outer_noise_sd: Array  # (3,) SD of the errors that these leave, rad and m
    fits: tuple[LoopFit, ...]  # the recordings that it was learned from

    @staticmethod
    def of(fits: Sequence[LoopFit]) -> FleetPrior:
        """Return the prior from the fits to recordings of some instruments (TrocarError: they are fewer than two)."""
        if len(fits) < 2:
            raise InvalidInput("a prior", f"cannot be learned from {len(fits)} recordings", "give two or more")
        shapes, weights, outer, left = (
            np.array([getattr(fit, name) for fit in fits]) for name in ("shape", "weights", "outer", "left")
        )
        spread = np.sqrt(1.0 + 1.0 / len(fits))  # a new recording deviates more from this mean than these do
        factors = []
        for joint in range(3):
            away = weights[:, joint] - weights[:, joint].mean(axis=0)
            covariance = spread**2 * away.T @ away / (len(fits) - 1) + COMMON * np.diag(_least_sd(joint) ** 2)
            factors.append(np.linalg.cholesky(covariance))
        outer_sd = np.sqrt(np.mean(outer**2, axis=0))
        outer_sd[:, 0] = np.maximum(outer[:, :, 0].std(axis=0), OUTER_OFFSET_SD)
        noise_sd = np.sqrt(np.median(left, axis=0))
        return FleetPrior(
            shape_mean=shapes.mean(axis=0),
            shape_sd=np.maximum(spread * shapes.std(axis=0, ddof=1), LEAST_SHAPE_SD),
            weights=weights.mean(axis=0),
            factors=np.array(factors),
            noise_sd=noise_sd[WRIST],
            outer_sd=outer_sd,
            outer_noise_sd=noise_sd[:3],
            fits=tuple(fits),
        )

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the names of the recordings that it was learned from."""
        return tuple(fit.name for fit in self.fits)

    def without(self, instrument: str) -> FleetPrior:
        """Return the prior without recordings whose names begin with ``instrument`` (TrocarError: under two left)."""
        return FleetPrior.of([fit for fit in self.fits if not fit.name.startswith(instrument)])

    def save(self, path: str | Path) -> Path:
        """Write the prior to an ``.npz`` file: what was fitted to each recording."""
        path = Path(path)
        if path.suffix != ".npz":
            raise BadFile(path, "must end in .npz", "choose another name", kind="prior")
        header = {"format": FORMAT, "version": VERSION, "sources": list(self.sources)}
        arrays = {name: np.array([getattr(fit, name) for fit in self.fits]) for name in _SHAPES}
        return Archive(header, arrays).save(path)


def load_prior(name: str | Path) -> FleetPrior:
    """Return the built-in prior (``fleet``), or that in a file (TrocarError: there is none, or it is no prior)."""
    if str(name) == BUILT_IN:
        with as_file(files("trocar.calibration.fleet") / "fleet.npz") as path:
            return _load(path)
    return _load(Path(name))


def _load(path: Path) -> FleetPrior:
    archive = read_archive(path, FORMAT, VERSION)
    sources = archive.header.get("sources")
    try:
        if not isinstance(sources, list) or not all(isinstance(source, str) for source in sources):
            raise InvalidInput("it", "does not say what it was learned from")
        arrays = {name: np.asarray(a, dtype=np.float64) for name, a in shaped(archive.arrays, **_SHAPES).items()}
        if len(sources) != len(arrays["left"]):
            raise InvalidInput("it", f"names {len(sources)} recordings and has fits to {len(arrays['left'])}")
        if (arrays["left"] <= 0).any():
            raise InvalidInput("'left'", "holds values that are not variances")
        fits = [LoopFit(name, *(arrays[key][k] for key in _SHAPES)) for k, name in enumerate(sources)]
        return FleetPrior.of(fits)
    except TrocarError as error:
        raise BadFile(path, f"is damaged: {error}", "learn it again", kind="prior") from None


def _least_sd(joint: int) -> Array:
    """Return the least SDs (FEATURES,) of one joint's weights."""
    sd = np.full(FEATURES, SLACK_SD)
    sd[0], sd[1:4], sd[1 + joint] = OFFSET_SD, COUPLING_SD, OWN_SD[joint]
    return sd


def learn_prior(recordings: Sequence[Recording]) -> FleetPrior:
    """Return the prior learned from recordings of some instruments (InvalidInput: they are fewer than two)."""
    return FleetPrior.of([fit_loops(recording) for recording in recordings])
