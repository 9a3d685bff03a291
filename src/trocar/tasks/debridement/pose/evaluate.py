"""How well a pose is predicted some time after the last detection, from the past alone."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput, InvalidValue
from trocar.tasks.debridement.pose.estimators import PoseEstimator
from trocar.tasks.debridement.pose.pairs import PosePairs

E = TypeVar("E", bound=PoseEstimator)

HORIZONS_S = (1.0, 2.0, 5.0)
SAME_IMAGE_S = 0.05
"""Detections closer than this come from one image: the camera has at most 10 Hz (V-A.2)."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Errors of one estimator at one horizon, for all targets in order of time.

    Attributes:
        horizon_s: minimum age of the last detection given to the estimator.
        targets: (m,) indices of the pairs that were predicted.
        ages_s: (m,) true age of that detection; gaps make it longer than the horizon.
        translation_m: (m,) distances to the detected position.
        rotation_rad: (m,) angles to the detected orientation.
    """

    horizon_s: float
    targets: NDArray[np.int_]
    ages_s: NDArray[np.float64]
    translation_m: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]


@dataclass(frozen=True)
class Summary:
    """Mean, root mean square and 95th percentile of errors, in the errors' unit."""

    mean: float
    rms: float
    p95: float

    @staticmethod
    def of(values: NDArray[np.float64]) -> Summary:
        """Return the summary of values (m,)."""
        return Summary(float(values.mean()), float(np.sqrt(np.mean(values**2))), float(np.percentile(values, 95)))


@dataclass(frozen=True)
class Ratio:
    """Ratio of two mean errors with its 95 % interval."""

    value: float
    low: float
    high: float


def replay(make: Callable[[], E], pairs: PosePairs, horizon_s: float) -> Iterator[tuple[int, int, E]]:
    """Yield each target pair, the last pair whose detection may be known, and an estimator ready for the target.

    For target k it was given detections up to ``t_k - horizon_s``, and kinematic poses up to pair k - 1. Pairs without
    a detection that old are not targets.

    Raises:
        InvalidValue: the horizon is not above 0.
    """
    if not horizon_s > 0:
        raise InvalidValue("the horizon", f"{horizon_s} s", "give a number above 0")
    t_s, detected, kinematic = pairs.times_s, pairs.T_base_detected, pairs.T_base_kinematic
    estimator, known = make(), 0
    for k in range(len(pairs)):
        while known < k and t_s[known] <= t_s[k] - horizon_s:
            estimator.update(t_s[known], kinematic[known], detected[known])
            known += 1
        if not known:
            continue
        blind = copy.deepcopy(estimator)
        for i in range(known, k):
            blind.update(t_s[i], kinematic[i], None)
        yield k, known - 1, blind


def prediction_errors(make: Callable[[], PoseEstimator], pairs: PosePairs, horizon_s: float) -> PredictionErrors:
    """Return the errors of a fresh estimator over all targets of :func:`replay`.

    Raises:
        InvalidInput: the recording is shorter than the horizon.
    """
    rows = []
    for k, last, estimator in replay(make, pairs, horizon_s):
        T = estimator.estimate(pairs.times_s[k], pairs.T_base_kinematic[k])
        seen = pairs.T_base_detected[k]
        shift_m = np.linalg.norm(T.translation_m - seen.translation_m)
        turn_rad = (T.rotation.inverse() @ seen.rotation).angle()
        rows.append((k, pairs.times_s[k] - pairs.times_s[last], shift_m, turn_rad))
    if not rows:
        raise InvalidInput(
            "the recording", f"has no pair {horizon_s} s after another", "give a longer one or a shorter horizon"
        )
    k, ages_s, translation_m, rotation_rad = np.array(rows, dtype=np.float64).T
    return PredictionErrors(horizon_s, k.astype(int), ages_s, translation_m, rotation_rad)


def ratio_of_means(
    errors: NDArray[np.float64],
    reference: NDArray[np.float64],
    rng: np.random.Generator,
    block: int = 10,
    draws: int = 2000,
) -> Ratio:
    """Return mean error over mean reference, both (m,) of the same targets, with a moving-blocks bootstrap.

    Args:
        errors: in order of time.
        reference: likewise.
        rng: draws the blocks.
        block: number of consecutive targets drawn together, since neighbours share their errors; 10 pairs are some 2.5
            s.
        draws: of the bootstrap.
    """
    m = len(errors)
    block = min(block, m)
    starts = rng.integers(0, m - block + 1, (draws, -(-m // block)))
    rows = (starts[..., None] + np.arange(block)).reshape(draws, -1)[:, :m]
    low, high = np.percentile(errors[rows].mean(1) / reference[rows].mean(1), [2.5, 97.5])
    return Ratio(float(errors.mean() / reference.mean()), float(low), float(high))


def detection_noise(pairs: PosePairs, within_s: float = 0.7) -> NDArray[np.float64]:
    """Return the covariance (3, 3) in m^2 of the noise of detected positions: a floor under every prediction error.

    Of three successive images within ``within_s``, the middle one is compared with the line through the others, after
    subtracting the kinematic position. Slower changes, of the camera or of the arm, are not included.

    Raises:
        InvalidInput: there are no three such images.
    """
    # The first pair of each image; those that follow within a few milliseconds repeat its position.
    rows = np.flatnonzero(np.diff(pairs.times_s, prepend=-np.inf) > SAME_IMAGE_S)
    t_s = pairs.times_s[rows]
    error_m = (pairs.T_base_detected.translation_m - pairs.T_base_kinematic.translation_m)[rows]
    near = np.flatnonzero(t_s[2:] - t_s[:-2] <= within_s)
    if not len(near):
        raise InvalidInput("the recording", f"has no three images within {within_s} s", "give one with more detections")
    share = ((t_s[1:-1] - t_s[:-2]) / (t_s[2:] - t_s[:-2]))[near, None]
    bend = error_m[near + 1] - (1 - share) * error_m[near] - share * error_m[near + 2]
    bend /= np.sqrt(1 + share**2 + (1 - share) ** 2)
    return bend.T @ bend / len(bend)
