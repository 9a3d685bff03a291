"""From the spheres in all images of a collection to base and joints; what does not fit is flagged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.geometry.rigid_fit import fit_rigid
from trocar.perception.fiducials.fixture import Fixture
from trocar.perception.fiducials.joints import MIN_ON_JAW, joints_from_spheres, require_psm

SHAFT_OFF_M = 1.0e-3
"""A shaft centre further from where the outer joints' encoders put it is rejected; their errors are about .1 mm."""
DISTANCE_OFF_M = 1.0e-3
"""Maximum difference between the measured and the printed distance of two jaw spheres; measured: .1 mm RMS."""
MIN_ROWS = 10

GOOD, NOTHING, NO_SHAFT, NO_JAW = "good", "no sphere", "no sphere on the shaft", "fewer than 3 spheres on the jaw"


@dataclass(frozen=True, eq=False)
class HandEye:
    """The pose of an arm's base in a camera.

    Attributes:
        T_camera_base: pose.
        rms_m: residual of the centres.
        used: number of centres.
        rejected: number of centres that do not agree.
    """

    T_camera_base: SE3
    rms_m: float
    used: int
    rejected: int


@dataclass(frozen=True, eq=False)
class Measured:
    """The result of a collection of images.

    Attributes:
        hand_eye: the base in the camera.
        q: (n, 6) joints, NaN where they could not be found.
        flags: (n,) of each row: 'good' or what is wrong.
        distance_rms_m: error of the distances between spheres of one part against those printed.
        p_camera_m: (n, k, 3) the accepted centres; else NaN.
    """

    hand_eye: HandEye
    q: NDArray[np.float64]
    flags: tuple[str, ...]
    distance_rms_m: float
    p_camera_m: NDArray[np.float64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return which rows (n,) are good."""
        return np.array([flag == GOOD for flag in self.flags])

    def counts(self) -> dict[str, int]:
        """Return the number of rows with each flag."""
        return {flag: self.flags.count(flag) for flag in sorted(set(self.flags))}


def measure(
    arm: ArmModel,
    fixture: Fixture,
    p_camera_m: NDArray[np.float64],
    q_cmd: NDArray[np.float64],
    rng: np.random.Generator,
) -> Measured:
    """Return base and joints from the spheres' centres, for rows in which the arm was at rest.

    Args:
        arm: a PSM.
        fixture: that it wears.
        p_camera_m: (n, k, 3) centres in the camera frame, NaN where a sphere was not seen.
        q_cmd: (n, 6) encoder readings.
        rng: of the search for outliers.
    """
    hand_eye = register_base(arm, fixture, p_camera_m, q_cmd, rng)
    p_base = hand_eye.T_camera_base.inverse().apply(p_camera_m)
    expected = fixture.base_centers_m(arm, q_cmd)
    off_shaft = np.linalg.norm(p_base - expected, axis=-1) > SHAFT_OFF_M
    p_base = np.where((off_shaft & fixture.on_shaft)[..., None], np.nan, p_base)
    p_base = without_wrong_distances(fixture, p_base)
    seen = np.all(np.isfinite(p_base), axis=-1)
    q = joints_from_spheres(arm, fixture, p_base, q_cmd)
    flags = [_flag(fixture, row) for row in seen]
    accepted = np.where(seen[..., None], p_camera_m, np.nan)
    return Measured(hand_eye, q, tuple(flags), _rms(distance_errors_m(fixture, accepted)), accepted)


def register_base(
    arm: ArmModel,
    fixture: Fixture,
    p_camera_m: NDArray[np.float64],
    q_cmd: NDArray[np.float64],
    rng: np.random.Generator,
) -> HandEye:
    """Return the rigid fit of the shaft's spheres, placed by the encoders, to those in the camera, without outliers.

    The outer joints' encoders are exact to .3 mrad and .1 mm, so many positions of the shaft give the base.

    Raises:
        TrocarError: the arm is no PSM, or the shaft was seen in too few rows.
    """
    require_psm(arm)
    seen = np.isfinite(p_camera_m).all(-1) & fixture.on_shaft
    if seen.any(axis=1).sum() < MIN_ROWS:
        raise TrocarError(
            f"the shaft's spheres were seen in {seen.any(axis=1).sum()} images; the base needs {MIN_ROWS} or more: "
            "collect more rows, or look whether the camera sees the arm"
        )
    source, target = fixture.base_centers_m(arm, q_cmd)[seen], p_camera_m[seen]
    fit = fit_rigid(source, target, inlier_distance_m=SHAFT_OFF_M, rng=rng)
    used = int(fit.inliers.sum())
    return HandEye(fit.T_target_source, fit.rms_m, used, len(source) - used)


def distance_errors_m(fixture: Fixture, p_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return measured minus printed distances (n, pairs) between spheres of one part, NaN where one was not seen."""
    pairs = [
        (a, b) for a, b in combinations(range(len(fixture.spheres)), 2) if fixture.on_shaft[a] == fixture.on_shaft[b]
    ]
    first, second = np.array(pairs).T
    printed = np.linalg.norm(fixture.centers_m[first] - fixture.centers_m[second], axis=1)
    return np.linalg.norm(p_m[:, first] - p_m[:, second], axis=-1) - printed


def without_wrong_distances(fixture: Fixture, p_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return centres (n, k, 3) with NaN for jaw spheres at wrong distances from most other jaw spheres."""
    p_m = p_m.copy()
    jaw = np.flatnonzero(~fixture.on_shaft)
    printed = np.linalg.norm(fixture.centers_m[jaw, None] - fixture.centers_m[None, jaw], axis=-1)
    for _ in range(len(jaw)):
        found = np.linalg.norm(p_m[:, jaw, None] - p_m[:, None, jaw], axis=-1)
        wrong = (np.abs(found - printed) > DISTANCE_OFF_M).sum(-1)
        rows = np.flatnonzero(wrong.max(axis=1) > 0)
        if not len(rows):
            break
        p_m[rows, jaw[wrong[rows].argmax(axis=1)]] = np.nan
    return p_m


def _flag(fixture: Fixture, seen: NDArray[np.bool_]) -> str:
    """Return the flag of a row in which these spheres (k,) are accepted."""
    if not seen.any():
        return NOTHING
    if not seen[fixture.on_shaft].any():
        return NO_SHAFT
    return GOOD if seen[~fixture.on_shaft].sum() >= MIN_ON_JAW else NO_JAW


def _rms(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
