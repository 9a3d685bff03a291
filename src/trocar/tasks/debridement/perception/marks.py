"""The coloured marks on a gripper's fingers in both eyes, and the pose that explains them (Kehoe 2014, V-A.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms.instrument import FingerMarks
from trocar.geometry import SE3, SO3
from trocar.perception.color import HueRange, to_hsv
from trocar.perception.depth import rays_through
from trocar.perception.image import Intrinsics, StereoImage, StereoRig
from trocar.perception.stereo import triangulate

FARTHEST_M = 0.6  # a mark farther away than this is too small to be trusted
NEAREST_M = 0.08
MIN_SHARE = 0.12
"""Least share of a mark's disc at the greatest distance; smaller spots are noise, or slivers beside what hides the
mark."""
MAX_BLOBS = 4  # maximum number of spots of one colour in one picture that are considered, the largest first
MAX_MISS_M = 1.2e-3
"""Maximum distance by which the rays to one mark may miss each other; if half of a mark is hidden from one eye, it
shifts this far."""
SPACING_OFF_M = 2.5e-3  # maximum error of the distance between a finger's two marks


@dataclass(frozen=True, eq=False)
class Blob:
    """A spot of one colour in one picture, or one half of it: two marks may look like one spot."""

    middle_px: NDArray[np.float64]  # (2,) u, v of its centroid
    area_px: float  # number of its pixels
    merged_px: NDArray[np.float64] | None = None  # (n, 2) pixels of the whole spot if this is one half of it


@dataclass(frozen=True, eq=False)
class MarkPair:
    """One mark in both eyes, where it is (3,) in the left camera's frame, and how far the rays to it miss."""

    left: Blob
    right: Blob
    point_m: NDArray[np.float64]
    miss_m: float


def find_blobs(hsv: NDArray[np.uint8], color: HueRange, lens: Intrinsics, marks: FingerMarks) -> list[Blob]:
    """Return the spots of a colour that may be marks, the largest first; of a single spot, its halves as well."""
    count, labels, stats, middles = cv2.connectedComponentsWithStats(color.mask(hsv), connectivity=4)
    areas = stats[1:count, cv2.CC_STAT_AREA].astype(np.float64)
    least = max(4.0, MIN_SHARE * np.pi * (marks.radius_m * lens.fx / FARTHEST_M) ** 2)
    order = np.argsort(-areas, kind="stable")
    order = order[areas[order] >= least][:MAX_BLOBS]
    blobs = [Blob(middles[1 + k].astype(np.float64), float(areas[k])) for k in order]
    if len(blobs) != 1:
        return blobs
    u, v, wide, high = stats[1 + order[0], :4]
    pixels = np.argwhere(labels[v : v + high, u : u + wide] == 1 + order[0])[:, ::-1] + [u, v]
    return blobs + _halves(pixels.astype(np.float64))


def _halves(pixels: NDArray[np.float64]) -> list[Blob]:
    """Return a spot cut in two across its longest direction."""
    off = pixels - pixels.mean(0)
    along = np.linalg.eigh(off.T @ off)[1][:, -1]
    ahead = off @ along > 0
    return [Blob(pixels[half].mean(0), float(half.sum()), pixels) for half in (ahead, ~ahead) if half.any()]


def pair_blobs(rig: StereoRig, left: list[Blob], right: list[Blob], marks: FingerMarks) -> list[list[MarkPair]]:
    """Return interpretations of a finger's spots, the likeliest first: its two marks, one mark, none.

    Two marks are two pairs of spots whose rays meet, at the known distance; one mark is a whole spot in both eyes.
    """
    pairs = []
    for one, other in product(left, right):
        point, miss = triangulate(rig, one.middle_px, other.middle_px)
        if miss <= MAX_MISS_M and NEAREST_M <= point[2] <= FARTHEST_M:
            pairs.append(MarkPair(one, other, point, float(miss)))
    spacing = marks.along_m[1] - marks.along_m[0]
    couples = []
    for one, two in combinations(pairs, 2):
        off = abs(float(np.linalg.norm(one.point_m - two.point_m)) - spacing)
        if _apart(one.left, two.left) and _apart(one.right, two.right) and off <= SPACING_OFF_M:
            couples.append((off + one.miss_m + two.miss_m, [one, two]))
    whole = [(pair.miss_m, [pair]) for pair in pairs if pair.left.merged_px is None and pair.right.merged_px is None]
    options = [min(found, key=lambda option: option[0])[1] for found in (couples, whole) if found]
    return [*options, []]


def _apart(one: Blob, other: Blob) -> bool:
    """Return whether two spots can be two marks: a whole spot and a half of it cannot."""
    return one is not other and (one.merged_px is None) == (other.merged_px is None)


def mark_points_m(marks: FingerMarks, tip_length_m: float, jaw_rad: float) -> NDArray[np.float64]:
    """Return the middles (4, 3) of the marks in the tip frame: left finger near and far, right finger near and far."""
    in_finger = np.concatenate([marks.centers_m(side, jaw_rad) for side in (1, -1)])
    return tip_from_finger(in_finger, tip_length_m)


def tip_from_finger(points_m: NDArray[np.float64], tip_length_m: float) -> NDArray[np.float64]:
    """Return points (..., 3) given along the closed finger, out of the closing plane and along the jaw axis."""
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([y, -z, tip_length_m - x], -1)


def seen_blobs(image: StereoImage, marks: FingerMarks) -> list[tuple[list[Blob], list[Blob]]]:
    """Return for the left and the right finger the spots in the left and in the right picture."""
    eyes = [(to_hsv(image.left), image.rig.left), (to_hsv(image.right), image.rig.right)]
    found = [[find_blobs(hsv, HueRange.around(color), lens, marks) for hsv, lens in eyes] for color in marks.colors]
    return [(left, right) for left, right in found]


JAW_GUESSES = np.radians(np.arange(0.0, 125.0, 15.0))
JAW_RANGE = np.radians([-12.0, 135.0])
MAX_ROUGH_M = 3e-3  # maximum RMS distance of the marks from their places for a guess good enough to refine
STEPS = 8
STEP_DONE = 1e-6
SPOT_SD_PX = 0.25  # standard deviation of a spot's middle from which the uncertainty of a fit is computed


@dataclass(frozen=True, eq=False)
class Spot:
    """A mark as seen by one eye."""

    mark: int  # its number, as in ``mark_points_m``
    right: bool  # whether the right eye saw it
    blob: Blob  # the spot
    middle_px: NDArray[np.float64]  # (2,) u, v of the spot, corrected for occlusion by the fingers


@dataclass(frozen=True, eq=False)
class Fit:
    """A gripper that explains the spots: its pose in the left eye's frame, and its opening."""

    T_camera_tip: SE3
    jaw_rad: float
    residual_px: float = np.inf  # root mean square of u and v
    sd_m: float = np.inf  # standard deviation of the place, in its worst direction
    sd_rad: float = np.inf  # likewise of the rotation


def rough_fit(named: Mapping[int, MarkPair], marks: FingerMarks, tip_length_m: float) -> Fit | None:
    """Return the best rigid fit to the triangulated points over all openings (Kabsch), or None if there is none."""
    seen = np.array([pair.point_m for pair in named.values()])
    models = _guessed(marks, tip_length_m)[:, list(named)]
    middles = models.mean(1, keepdims=True)
    u, _, vt = np.linalg.svd(np.einsum("ji,kjl->kil", seen - seen.mean(0), models - middles))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turns = u @ vt
    moved = np.einsum("kil,kjl->kji", turns, models - middles) + seen.mean(0)
    rms = np.sqrt(np.mean(np.sum((moved - seen) ** 2, -1), -1))
    best = int(np.argmin(rms))
    if rms[best] > MAX_ROUGH_M:
        return None
    place = seen.mean(0) - turns[best] @ middles[best, 0]
    return Fit(SE3.from_parts(SO3.unchecked(turns[best]), place), float(JAW_GUESSES[best]))


def fit_marks(spots: Sequence[Spot], rig: StereoRig, marks: FingerMarks, tip_length_m: float, guess: Fit) -> Fit:
    """Return the pose and opening that bring the marks nearest to the spots in both eyes (Gauss-Newton)."""
    R, t, jaw = guess.T_camera_tip.rotation.matrix, guess.T_camera_tip.translation_m, guess.jaw_rad
    R_left_right, shift = rig.T_left_right.rotation.matrix, rig.T_left_right.translation_m
    mark, in_right = np.array([spot.mark for spot in spots]), np.array([spot.right for spot in spots])
    flat_seen = np.array([rays_through((rig.left, rig.right)[spot.right], spot.middle_px)[:2] for spot in spots])
    residual, full = np.zeros_like(flat_seen), np.zeros((2 * len(spots), 7))
    for _ in range(STEPS):
        points, slopes = _model(marks, tip_length_m, jaw)
        turned = points[mark] @ R.T
        seen = turned + t
        jacobian = np.empty((len(seen), 3, 7))
        jacobian[:, :, :3] = np.eye(3)
        x, y, z = turned.T
        zero = np.zeros_like(x)
        jacobian[:, :, 3:6] = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], -1).reshape(-1, 3, 3)
        jacobian[:, :, 6] = slopes[mark] @ R.T
        seen[in_right] = (seen[in_right] - shift) @ R_left_right
        jacobian[in_right] = R_left_right.T @ jacobian[in_right]
        flat = seen[:, :2] / seen[:, 2:]
        residual = flat_seen - flat
        full = ((jacobian[:, :2] - flat[..., None] * jacobian[:, 2:]) / seen[:, 2:, None]).reshape(-1, 7)
        step = np.linalg.lstsq(full, residual.ravel(), rcond=1e-9)[0]
        t = t + step[:3]
        R = SO3.exp(step[3:6]).matrix @ R
        jaw = float(np.clip(jaw + step[6], JAW_RANGE[0] - 0.2, JAW_RANGE[1] + 0.2))
        if np.abs(step).max() < STEP_DONE:
            break
    rms = float(np.sqrt(np.mean(residual**2)))
    covariance = np.linalg.pinv(full.T @ full) * (SPOT_SD_PX / rig.left.fx) ** 2
    sd_m, sd_rad = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (covariance[:3, :3], covariance[3:6, 3:6]))
    return Fit(SE3.from_parts(SO3.unchecked(R), t), jaw, rms * rig.left.fx, sd_m, sd_rad)


def _model(marks: FingerMarks, tip_length_m: float, jaw_rad: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the marks' middles (4, 3) in the tip frame, and how they move with the opening (4, 3)."""
    in_finger = np.concatenate([marks.centers_m(side, jaw_rad) for side in (1, -1)])
    half = np.array([0.5, 0.5, -0.5, -0.5])
    turning = np.column_stack([-half * in_finger[:, 1], half * in_finger[:, 0], np.zeros(4)])
    return tip_from_finger(in_finger, tip_length_m), tip_from_finger(turning, 0.0)


@lru_cache(maxsize=16)
def _guessed(marks: FingerMarks, tip_length_m: float) -> NDArray[np.float64]:
    """Return the marks' middles (n, 4, 3) in the tip frame for each opening that is tried."""
    return np.array([mark_points_m(marks, tip_length_m, jaw) for jaw in JAW_GUESSES])
