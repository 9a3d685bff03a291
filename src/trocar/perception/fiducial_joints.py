"""Find base and joints of a PSM from the spheres in all images of a collection; flag rows that do not fit.

First in closed form (Hwang et al. 2022, IV-A), then by an adjustment of all images together.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, frames, ik
from trocar.errors import InvalidInput
from trocar.geometry import SE3, TURN
from trocar.geometry.arrays import Array
from trocar.geometry.rigid_fit import RigidFit, fit_rigid
from trocar.perception.fiducial_adjustment import adjust, turned_to_encoders
from trocar.perception.fiducials import Fixture

SHAFT_OFF_M = 1.0e-3
"""A shaft centre further than this from where the encoders put it is rejected; their errors are about .1 mm."""
DISTANCE_OFF_M = 1.0e-3
"""Maximum difference between the measured and the printed distance of two jaw spheres; measured: .1 mm RMS."""
ROOM_RAD, ROOM_M = 0.5, 0.05
"""Measured joints may exceed the arm's limits by this much, because of errors of cables and base."""
MIN_ON_JAW, MIN_ROWS = 3, 10
"""Least number of jaw spheres for a rotation of the jaw, and of rows with a shaft sphere for the base."""

GOOD, NOTHING, NO_SHAFT, NO_JAW = "good", "no sphere", "no sphere on the shaft", "fewer than 3 spheres on the jaw"


@dataclass(frozen=True, eq=False)
class Measured:
    """The result of a collection of images."""

    shaft: RigidFit  # of the shaft's spheres, placed by the encoders, to those in the camera: tells the outliers
    T_camera_base: SE3  # the base as all images have it
    q: Array  # (n, 6) joints in the base as registered, NaN where they could not be found
    flags: tuple[str, ...]  # (n,) of each row: 'good' or what is wrong
    distance_rms_m: float  # error of the distances between spheres of one part against those printed
    p_camera_m: Array  # (n, k, 3) the accepted centres; else NaN

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return which rows (n,) are good."""
        return np.array([flag == GOOD for flag in self.flags])

    def counts(self) -> dict[str, int]:
        """Return the number of rows with each flag."""
        return {flag: self.flags.count(flag) for flag in sorted(set(self.flags))}


def require_psm(arm: ArmModel) -> None:
    """Raise InvalidInput unless an arm has a PSM's first axes, perpendicular and through the remote centre."""
    half = np.pi / 2
    if not (np.allclose(arm.twists_rad, (half, -half, half)) and np.allclose(arm.offsets[:2], (half, -half))):
        problem = f"can be found from spheres on a PSM only, not on {arm.name!r}"
        raise InvalidInput("joints", problem, "give its recording")


def measure(
    arm: ArmModel, fixture: Fixture, p_camera_m: Array, q_cmd: Array, T_camera_base: SE3, rng: np.random.Generator
) -> Measured:
    """Return base and joints from the spheres' centres, for rows in which the arm was at rest.

    Args:
        arm: a PSM.
        fixture: the spheres that it wears.
        p_camera_m: (n, k, 3) centres in the camera frame, NaN where a sphere was not seen.
        q_cmd: (n, 6) encoder readings.
        T_camera_base: the base as registered. The joints returned put the tip where it was seen if the base is here,
            so they make up for the registration's error.
        rng: random numbers for the search for outliers.

    Raises:
        InvalidInput: the arm is no PSM, or the shaft was seen in too few rows.
    """
    shaft = register_base(arm, fixture, p_camera_m, q_cmd, rng)
    T_found = shaft.T_target_source
    p_base = T_found.inverse().apply(p_camera_m)
    expected = fixture.base_centers_m(arm, q_cmd)
    off_shaft = np.linalg.norm(p_base - expected, axis=-1) > SHAFT_OFF_M
    p_base = np.where((off_shaft & fixture.on_shaft)[..., None], np.nan, p_base)
    p_base = without_wrong_distances(fixture, p_base)
    seen = np.all(np.isfinite(p_base), axis=-1)
    q = joints_from_spheres(arm, fixture, p_base, q_cmd)
    accepted = np.where(seen[..., None], p_camera_m, np.nan)
    errors_m = distance_errors_m(fixture, accepted)
    known = errors_m[np.isfinite(errors_m)]
    rms_m = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
    flags = tuple(_flag(fixture, row) for row in seen)
    whole = np.isfinite(q).all(axis=1)
    if whole.any():
        found = adjust(arm, fixture, accepted[whole], T_found, q[whole])
        T_camera_tip = found.T_camera_base @ fk(found.arm, found.q)
        q[whole] = joints_of_tips(arm, T_camera_base.inverse() @ T_camera_tip, found.q)
        T_found = turned_to_encoders(arm, found.T_camera_base, found.q, q_cmd[whole])
    q[~whole] = np.nan
    return Measured(shaft, T_found, q, flags, rms_m, accepted)


def joints_of_tips(arm: ArmModel, T_base_tip: SE3, near: Array) -> Array:
    """Return the joints (n, 6) that put the tip there, nearest to ``near`` (n, 6); NaN if it is out of reach."""
    return ik(arm.widened(ROOM_RAD, ROOM_M), T_base_tip, reference=near, unreachable="nan")


def register_base(
    arm: ArmModel, fixture: Fixture, p_camera_m: Array, q_cmd: Array, rng: np.random.Generator
) -> RigidFit:
    """Return the rigid fit of the shaft's spheres, placed by the encoders, to those in the camera, without outliers.

    The outer joints' encoders are exact to .3 mrad and .1 mm, so many positions of the shaft determine the base.

    Raises InvalidInput: the arm is no PSM, or the shaft was seen in too few rows.
    """
    require_psm(arm)
    seen = np.isfinite(p_camera_m).all(-1) & fixture.on_shaft
    images = int(seen.any(axis=1).sum())
    if images < MIN_ROWS:
        problem = f"were seen in {images} images; the base needs {MIN_ROWS} or more"
        raise InvalidInput("the shaft's spheres", problem, "collect more rows, or look whether the camera sees the arm")
    source, target = fixture.base_centers_m(arm, q_cmd)[seen], p_camera_m[seen]
    return fit_rigid(source, target, inlier_distance_m=SHAFT_OFF_M, rng=rng)


def distance_errors_m(fixture: Fixture, p_m: Array) -> Array:
    """Return measured minus printed distances (n, pairs) between spheres of one part, NaN where one was not seen."""
    pairs = [
        (a, b) for a, b in combinations(range(len(fixture.spheres)), 2) if fixture.on_shaft[a] == fixture.on_shaft[b]
    ]
    first, second = np.array(pairs).T
    printed = np.linalg.norm(fixture.centers_m[first] - fixture.centers_m[second], axis=1)
    return np.linalg.norm(p_m[:, first] - p_m[:, second], axis=-1) - printed


def without_wrong_distances(fixture: Fixture, p_m: Array) -> Array:
    """Return centres (n, k, 3) with NaN for jaw spheres at wrong distances from others, the worst first."""
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


def joints_from_spheres(arm: ArmModel, fixture: Fixture, p_base_m: Array, q_cmd: Array) -> Array:
    """Return the joints (n, 6) of a PSM whose spheres have these centres (n, k, 3) in its base.

    Centres of spheres that were not seen are NaN, and so are joints that cannot be determined. The commands (n, 6) only
    decide between rolls that differ by full turns.

    Raises InvalidInput: the arm is no PSM.
    """
    require_psm(arm)
    q = np.full((len(p_base_m), 6), np.nan)
    q[:, :3] = _outer_joints(arm, fixture, p_base_m)
    R_base_jaw = _jaw_rotations(arm, fixture, p_base_m)
    whole = np.isfinite(q[:, :3]).all(axis=1) & np.isfinite(R_base_jaw).all(axis=(-1, -2))
    q[whole, 3:] = _wrist_joints(arm, R_base_jaw[whole], q[whole, :3], q_cmd[whole, 3])
    return q


def _outer_joints(arm: ArmModel, fixture: Fixture, p_base_m: Array) -> Array:
    """Return q1 q2 q3 (n, 3); NaN if no shaft sphere was seen.

    The shaft runs through the remote centre, the base's origin, and its spheres sit on its axis. So their direction
    gives yaw and pitch (farther spheres weigh more), and their distance the insertion.
    """
    p = p_base_m[:, fixture.on_shaft]
    seen = np.all(np.isfinite(p), axis=-1)
    distance = np.where(seen, np.linalg.norm(p, axis=-1), 0.0)
    along = np.einsum("nk,nkx->nx", distance, np.where(seen[..., None], p, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        axis = along / np.linalg.norm(along, axis=1, keepdims=True)
        up = fixture.centers_m[fixture.on_shaft, 2]
        depth = (seen * (np.einsum("nx,nkx->nk", axis, np.nan_to_num(p)) + up)).sum(axis=1) / seen.sum(axis=1)
    x, y, z = axis.T
    return np.column_stack([np.arctan2(x, -z), np.arcsin(np.clip(-y, -1.0, 1.0)), depth - arm.offsets[2]])


def _jaw_rotations(arm: ArmModel, fixture: Fixture, p_base_m: Array) -> Array:
    """Return the rotation (n, 3, 3) of frame 6 in the base that fits the jaw's spheres; NaN with fewer than three."""
    jaw = ~fixture.on_shaft
    known = fixture.frame_centers_m(arm)[jaw]
    rotations = np.full((len(p_base_m), 3, 3), np.nan)
    for row, p in enumerate(p_base_m[:, jaw]):
        seen = np.isfinite(p).all(axis=1)
        if seen.sum() >= MIN_ON_JAW:
            rotations[row] = fit_rigid(known[seen], p[seen]).T_target_source.rotation.matrix
    return rotations


def _wrist_joints(arm: ArmModel, R_base_jaw: Array, q_outer: Array, roll_near: Array) -> Array:
    """Return q4 q5 q6 (n, 3) with |q5| < 90 deg and the roll within half a turn of ``roll_near`` (n,)."""
    R_base_insertion = frames(arm, np.column_stack([q_outer, np.zeros_like(q_outer)])).matrix[:, 3, :3, :3]
    R = np.swapaxes(R_base_insertion, -1, -2) @ R_base_jaw
    jaw, axis = R[:, :, 1], -R[:, :, 2]  # the direction of the jaws, and the axis about which they turn
    w = arm.wrist_sign
    turn4 = np.arctan2(w * axis[:, 1], w * axis[:, 0])
    turn5 = np.arctan2(axis[:, 2], np.hypot(axis[:, 0], axis[:, 1]))
    c4, s4, c5, s5 = np.cos(turn4), np.sin(turn4), np.cos(turn5), np.sin(turn5)
    out = np.column_stack([s5 * c4, s5 * s4, -w * c5])
    side = np.column_stack([-s4, c4, np.zeros_like(c4)])
    turn6 = np.arctan2(-np.sum(side * jaw, axis=1), np.sum(out * jaw, axis=1))
    q = np.column_stack([turn4, turn5, turn6]) - np.array(arm.offsets[3:])
    q[:, 0] += TURN * np.round((roll_near - q[:, 0]) / TURN)
    return q


def _flag(fixture: Fixture, seen: NDArray[np.bool_]) -> str:
    """Return the flag of a row in which these spheres (k,) are accepted."""
    if not seen.any():
        return NOTHING
    if not seen[fixture.on_shaft].any():
        return NO_SHAFT
    return GOOD if seen[~fixture.on_shaft].sum() >= MIN_ON_JAW else NO_JAW
