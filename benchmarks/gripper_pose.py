"""Estimators of a gripper's pose from recorded pose pairs alone, without joints, and how well each predicts.

The pairs are detected and kinematic poses ``T_c`` and ``T_K`` of one gripper in its arm's base (Kehoe 2014, V-A.2).
``benchmarks/bench_gripper_pose.py`` prints the comparison, docs/debridement.md explains it. An estimator here has
``update``, given None where the camera saw nothing, and ``estimate``, which changes nothing.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.counting import counted
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose import PaperAdjustment


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Detected and kinematic poses of one gripper in the frame of its arm's base.

    Attributes:
        times_s: (n,) times of the detections, increasing.
        T_base_detected: (n,) poses seen by the camera.
        T_base_kinematic: (n,) poses by forward kinematics, of the same moments.
        note: what was done to the recording when it was read; empty if nothing was.
    """

    times_s: NDArray[np.float64]
    T_base_detected: SE3
    T_base_kinematic: SE3
    note: str = ""


def read_pairs(path: Path) -> PosePairs:
    """Return the pairs in a CSV file with a header; neighbouring pairs of one time are merged into their mean pose.

    Columns: ``t_detected_s``, then ``x_m y_m z_m yaw_deg pitch_deg roll_deg`` twice, prefixed with ``detected_`` and
    with ``kinematic_``; others are ignored. Angles turn about the base's fixed axes, roll about x first, then pitch
    about y, then yaw about z. The recording does not state the order: with this one, its two sources differ by 23 deg
    on average, which agrees with the whole recording (24.5 deg); with yaw first it is 120.
    """
    rows = np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True))
    times_s = rows["t_detected_s"]
    if not (np.isfinite(times_s).all() and (np.diff(times_s) >= 0).all()):
        raise SystemExit(f"{path}: its times are not numbers in increasing order; sort the pairs by time")
    moment = np.cumsum(np.diff(times_s, prepend=np.nan) != 0) - 1
    first = np.flatnonzero(np.diff(moment, prepend=-1))
    repeats = len(times_s) - len(first)
    note = f"{counted(repeats, 'pair')} of {len(times_s)} repeated the time of the one before: merged"
    detected, kinematic = (_means(_poses(rows, source), moment) for source in ("detected", "kinematic"))
    return PosePairs(times_s[first], detected, kinematic, note if repeats else "")


def _poses(rows: NDArray, source: str) -> SE3:
    x, y, z = (rows[f"{source}_{axis}_m"] for axis in "xyz")
    yaw, pitch, roll = (np.radians(rows[f"{source}_{angle}_deg"]) for angle in ("yaw", "pitch", "roll"))
    return SE3.from_parts(SO3.axis("z", yaw) @ SO3.axis("y", pitch) @ SO3.axis("x", roll), np.stack([x, y, z], -1))


def _means(T: SE3, group: NDArray[np.int_]) -> SE3:
    """Return the mean pose of each group of neighbouring poses: of positions, and the chordal mean of rotations."""
    sums = np.zeros((group[-1] + 1, 4, 4))
    np.add.at(sums, group, T.matrix)
    u, _, vt = np.linalg.svd(sums[:, :3, :3])
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return SE3.from_parts(SO3(u @ vt), sums[:, :3, 3] / sums[:, 3:, 3])


class RawKinematics:
    """Trusts the forward kinematics, as the Raven's control software does."""

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Do nothing."""

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose."""
        return T_base_kinematic


class HeldError:
    """Adds the last seen ``p_c - p_K`` and ``R_c R_K^-1``, both in the base frame, to the kinematics."""

    def __init__(self) -> None:
        self._last: tuple[SE3, SE3] | None = None

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Learn from a detection."""
        if T_base_detected is not None:
            self._last = T_base_detected, T_base_kinematic

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose with the last error added."""
        if self._last is None:
            return T_base_kinematic
        detected, kinematic = self._last
        R = detected.rotation @ kinematic.rotation.inverse() @ T_base_kinematic.rotation
        return SE3.from_parts(R, T_base_kinematic.translation_m + detected.translation_m - kinematic.translation_m)


class PapersRule:
    """The rule of the method ``paper``, fed with pairs."""

    def __init__(self) -> None:
        self.rule = PaperAdjustment()

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Learn from a detection."""
        if T_base_detected is not None:
            self.rule.learn(T_base_kinematic, T_base_detected)

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the last detection extended by the adjusted increment."""
        return self.rule.estimate(T_base_kinematic)


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


def replay(make: Callable[[], Any], pairs: PosePairs, horizon_s: float) -> Iterator[tuple[int, int, Any]]:
    """Yield each target pair, the last pair whose detection may be known, and an estimator ready for the target.

    For target k it was given detections up to ``t_k - horizon_s``, and kinematic poses up to pair k - 1. Pairs without
    a detection that old are not targets.
    """
    t_s, detected, kinematic = pairs.times_s, pairs.T_base_detected, pairs.T_base_kinematic
    estimator, known = make(), 0
    for k in range(len(t_s)):
        while known < k and t_s[known] <= t_s[k] - horizon_s:
            estimator.update(t_s[known], kinematic[known], detected[known])
            known += 1
        if not known:
            continue
        blind = copy.deepcopy(estimator)
        for i in range(known, k):
            blind.update(t_s[i], kinematic[i], None)
        yield k, known - 1, blind


def prediction_errors(make: Callable[[], Any], pairs: PosePairs, horizon_s: float) -> PredictionErrors:
    """Return the errors of a fresh estimator over all targets of :func:`replay`."""
    rows = []
    for k, last, estimator in replay(make, pairs, horizon_s):
        T = estimator.estimate(pairs.times_s[k], pairs.T_base_kinematic[k])
        seen = pairs.T_base_detected[k]
        shift_m = np.linalg.norm(T.translation_m - seen.translation_m)
        turn_rad = (T.rotation.inverse() @ seen.rotation).angle()
        rows.append((k, pairs.times_s[k] - pairs.times_s[last], shift_m, turn_rad))
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
    """
    # The first pair of each image; those that follow within a few milliseconds repeat its position.
    rows = np.flatnonzero(np.diff(pairs.times_s, prepend=-np.inf) > SAME_IMAGE_S)
    t_s = pairs.times_s[rows]
    error_m = (pairs.T_base_detected.translation_m - pairs.T_base_kinematic.translation_m)[rows]
    near = np.flatnonzero(t_s[2:] - t_s[:-2] <= within_s)
    share = ((t_s[1:-1] - t_s[:-2]) / (t_s[2:] - t_s[:-2]))[near, None]
    bend = error_m[near + 1] - (1 - share) * error_m[near] - share * error_m[near + 2]
    bend /= np.sqrt(1 + share**2 + (1 - share) ** 2)
    return bend.T @ bend / len(bend)
