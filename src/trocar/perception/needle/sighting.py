"""Where a needle is, from depth images of one moment.

Points on the needle have to lie on its wire. A pixel that does not have the colour of the floor under the needle shows
the wire, so its ray has to meet it; a ray that ends on the floor, by its colour or its depth, must not have passed
through it. The wire is about two pixels wide and its depth scatters by most of its thickness: its position across the
rays comes from the colours, its distance from the mean of many points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.perception.depth import Patch, patch_around
from trocar.perception.image import RgbdImage
from trocar.perception.needle.arc import NeedleArc

FIRST_M, THEN_M = 2.5e-3, 1.3e-3
"""Points this close to the wire are taken for points on it: first of the expected wire, then of the one found."""
WIDE_M = 5.0e-3
"""Points this close to the expected wire decide between the results from several starts."""
SURE_M, AWAY, FAR_AWAY = 0.8e-3, 1.5, 3.0
"""If the wire's end is less certain than this (SD), the search starts from several poses, this many SDs away from the
expected one; if the result does not explain what is seen, it starts again even further away."""
ASIDE_M, UNEXPLAINED = 0.5e-3, 0.1
"""Steel pixels within ``WIDE_M`` whose rays miss the wire by this distance contradict a pose, and so do floor pixels
whose rays pass through the wire. If more than this share of the steel pixels do, the pose is rejected. (In the cell
there are none around a needle that was found, and a fifth around one that was not.)
"""
BEHIND_M = 1.5e-3
"""A ray that ends this far behind the wire passed it."""
OVER_FLOOR_M = 0.7e-3
"""Points lower than this over the floor are not on a needle."""
ON_FLOOR_M = 1.0e-3
"""Points this close to the floor show its colour."""
APART_M = 1.0e-3
"""Points this close to another known object may be on that object."""
IN_FRONT_M = 1.5e-3
"""A point this much nearer than the wire can be hides it."""
STEP_M, COARSE = 1.5e-3, 5
BEFORE_M = np.arange(-0.08, 0.004, STEP_M)
"""Positions along a ray, relative to where it is nearest to the wire, at which another object would hide the wire or be
taken for it. One in this many is tried first."""
UNLIKE = 0.05
"""Colours whose shares of red, green and blue differ by more are not the same."""
GREY = 0.25
"""Steel has less saturation."""
DARK = 0.12
"""Pixels with less than this share of the floor's light are in shadow and show no colour."""
SEARCH_PIXEL_M = 0.25e-3
"""While searching, pixels that are closer to each other on the needle than this are left out."""
SPACING_M, WIRE_SPACING_M = 0.4e-3, 0.1e-3
"""Spacing at which rays and the wire are sampled."""
POINT_SD_M, RAY_SD_PX = 0.35e-3, 0.25
"""SDs of a point's distance from the wire, and of the distance by which a ray misses it or passes through it."""
ROBUST = 1.5
"""A residual of more SDs than this counts less (Cauchy)."""
TOGETHER = 4.0
"""This many neighbouring points and rays share their error and count as one (chosen so that errors of looks in the cell
are as large as stated)."""
STEPS = 12
MOST_SHIFT_M, MOST_TURN_RAD = 0.5e-3, 0.1
"""Greatest step of the search."""
FEWEST, DEEP = 12, 0.4
"""Minimum number of pixels on the wire for it to count as seen, and the share of them that must have depth in each
image."""
STEEP = 0.4
"""If the sine of the angle between ray and wire is less, depth tells nothing about the wire."""
WORST_M = 0.9e-3
"""Points that scatter about the wire by more than this (SD) are not on it."""

Elsewhere = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signed distances (n,) of points (n, 3) in the camera's frame from other known objects."""


@dataclass(frozen=True, eq=False)
class NeedleSighting:
    """A normal likelihood of the needle's pose.

    Attributes:
        T_camera_needle: pose that fits best.
        information: (6, 6) of a twist of the needle in its own frame about that pose, 1/m and 1/rad.
        pixels: number of pixels that show the wire.
        left_m: robust SD of its depth.
    """

    T_camera_needle: SE3
    information: NDArray[np.float64]
    pixels: int
    left_m: float


@dataclass(frozen=True, eq=False)
class _Evidence:
    """The evidence of images, in the camera's frame.

    Attributes:
        points: (n, 3) on the wire.
        through: (m, k, 3) positions along rays that meet it.
        past: (l, k, 3) positions along rays that pass it.
        pixel_m: distance of neighbouring rays there.
    """

    points: NDArray[np.float64]
    through: NDArray[np.float64]
    past: NDArray[np.float64]
    pixel_m: float


def sight_needle(
    images: Sequence[RgbdImage],
    T_camera_needle: SE3,
    covariance: NDArray[np.float64],
    arc: NeedleArc,
    T_camera_floor: SE3,
    elsewhere: Elsewhere | None = None,
) -> NeedleSighting | None:
    """Return what depth images of one moment tell about a needle's pose; None if the needle is not seen.

    Args:
        images: with depth, by one camera, while nothing moves; more of them scatter less in depth.
        T_camera_needle: where it is expected.
        covariance: (6, 6) of a twist of the needle in its own frame about that pose, m and rad; it determines where the
            search begins, constrains it where the images show nothing, and is not part of the returned information.
        arc: its shape.
        T_camera_floor: a plane, z up, below which nothing of the needle is seen.
        elsewhere: distances of points from other known objects, such as the instrument that holds it; None: there are
            none.

    Raises:
        TrocarError: there is no image.
    """
    if not images:
        raise TrocarError("a needle is looked for in 0 images; give one or more")
    home = np.linalg.inv(covariance)
    pixel_m = float(T_camera_needle.translation_m[2]) / images[0].intrinsics.fx
    sparsely = max(1, round(SEARCH_PIXEL_M / pixel_m)) if pixel_m > 0.0 else 1

    def gathered(at: SE3, near_m: float, every: int = 1) -> _Evidence | None:
        return _gather(images, at, arc, near_m, T_camera_floor, elsewhere, every)

    def fitted(evidence: _Evidence, at: SE3) -> tuple[SE3, NDArray[np.float64], float]:
        information, left = np.zeros((6, 6)), 0.0
        for _ in range(STEPS):
            information, gradient, left = _normal_equations(evidence, at, arc)
            away = (T_camera_needle.inverse() @ at).log()
            step = np.linalg.solve(information + home, -gradient - home @ away)
            step /= max(1.0, np.abs(step[:3]).max() / MOST_SHIFT_M, np.abs(step[3:]).max() / MOST_TURN_RAD)
            at = at @ SE3.exp(step)
            if np.abs(step[:3]).max() < 1e-6 and np.abs(step[3:]).max() < 1e-4:
                break
        return at, information, left

    def searched(starts: Sequence[SE3]) -> NeedleSighting | None:
        near = [(start, found) for start in starts if (found := gathered(start, FIRST_M, sparsely)) is not None]
        first = [fitted(found, start)[0] for start, found in near]
        if len(starts) > 1 and (wide := gathered(T_camera_needle, WIDE_M, sparsely)) is not None:
            first.sort(key=lambda at: _missed_by(wide, at, arc))
        evidence = gathered(first[0], THEN_M) if first else None
        if evidence is None:
            return None
        at, information, left = fitted(evidence, first[0])
        around = gathered(at, WIDE_M, sparsely)
        if left > WORST_M or around is None or _unexplained(around, at, arc) > UNEXPLAINED:
            return None
        return NeedleSighting(at, information, len(evidence.through), left)

    starts = search_starts(T_camera_needle, covariance, arc)
    found = searched(starts)
    if found is None and len(starts) > 1:
        found = searched([T_camera_needle, *search_starts(T_camera_needle, covariance, arc, FAR_AWAY)[1:]])
    return found


def search_starts(
    T_camera_needle: SE3, covariance: NDArray[np.float64], arc: NeedleArc, away: float = AWAY
) -> list[SE3]:
    """Return where the search for a needle starts: at the expected pose, and around it if the tip is uncertain.

    Args:
        T_camera_needle: where it is expected.
        covariance: (6, 6) of a twist of the needle in its own frame about that pose, m and rad.
        arc: its shape.
        away: distance of the other starts, in SDs.
    """
    tip = arc.point_m(np.zeros(1))[0]
    lever = np.column_stack([np.eye(3), np.cross(np.eye(3), tip).T])
    sd, axes = np.linalg.eigh(lever @ covariance @ lever.T)
    starts = [T_camera_needle]
    for variance, axis in zip(sd, axes.T, strict=True):
        if variance > SURE_M**2:
            likeliest = covariance @ lever.T @ axis / np.sqrt(variance)  # twist that moves the tip by one SD along it
            starts += [T_camera_needle @ SE3.exp(share * likeliest) for share in (away, -away)]
    return starts


def _gather(
    images: Sequence[RgbdImage],
    T_camera_needle: SE3,
    arc: NeedleArc,
    near_m: float,
    T_camera_floor: SE3,
    elsewhere: Elsewhere | None,
    every: int,
) -> _Evidence | None:
    """Return what images show of a needle near this pose; None if it is too little.

    Colours are taken from the first image, since the others have the same. One in ``every`` rows and columns is read.
    """
    half = np.array([arc.radius_m, arc.radius_m, 0.0]) + 0.5 * arc.wire_m + max(near_m, FIRST_M)
    patches = [
        patch.thinned(every)
        for image in images
        if (patch := patch_around(image, T_camera_needle, -half, half)) is not None
    ]
    if not patches:
        return None
    T_needle, T_floor = T_camera_needle.inverse(), T_camera_floor.inverse()
    rays = patches[0].rays.reshape(-1, 3)
    z_near, beside = _along_rays(rays, T_camera_needle, arc, near_m)
    ours = beside < near_m
    ours[ours] = T_floor.apply(rays[ours] * z_near[ours, None])[:, 2] > OVER_FLOOR_M
    depth = np.array([patch.depth_m.ravel() for patch in patches])
    ours &= np.nan_to_num(depth, nan=np.inf).min(axis=0) >= z_near - near_m - IN_FRONT_M
    if elsewhere is not None:
        ours[ours] = _clear(elsewhere, rays[ours], z_near[ours])
    shows_floor, shows_steel = _colors(patches[0], T_floor)
    through = ours & shows_steel
    if through.sum() < FEWEST:
        return None
    points = (rays * depth[..., None])[:, through].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    on = (arc.distance_m(T_needle.apply(points)) < near_m) & (T_floor.apply(points)[:, 2] > OVER_FLOOR_M)
    if on.sum() < FEWEST * DEEP:
        return None
    past = ours & ~shows_steel & (shows_floor | (depth[0] > z_near + BEHIND_M))
    places = rays[:, None] * (z_near[:, None] + np.arange(-4, 5) * SPACING_M)[..., None]
    pixel_m = every * float(T_camera_needle.translation_m[2]) / images[0].intrinsics.fx
    return _Evidence(points[on], places[through], places[past], pixel_m)


def _along_rays(
    rays: NDArray[np.float64], T_camera_needle: SE3, arc: NeedleArc, near_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the depth (n,) of the wire where rays (n, 3) are nearest to it, and their least distances (n,) from it.

    Rays that pass it further away than ``near_m`` have an infinite distance.
    """
    count = 2 + int(arc.radius_m * arc.arc_rad / WIRE_SPACING_M)
    wire = T_camera_needle.apply(arc.point_m(np.linspace(0.0, arc.arc_rad, count)))
    farthest = (near_m + 0.5 * arc.wire_m) / wire[:, 2].min()
    apart, place = KDTree(wire[:, :2] / wire[:, 2:]).query(rays[:, :2], distance_upper_bound=farthest)
    depth = wire[np.minimum(place, count - 1), 2]
    return depth, depth * apart - 0.5 * arc.wire_m


def _clear(elsewhere: Elsewhere, rays: NDArray[np.float64], z_near: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rays (n, 3) reach these depths (n,) and a little further without meeting another object."""

    def least(which: NDArray[np.intp], before_m: NDArray[np.float64]) -> NDArray[np.float64]:
        along = rays[which, None] * (z_near[which, None] + before_m)[..., None]
        return elsewhere(along.reshape(-1, 3)).reshape(along.shape[:2]).min(axis=1)

    roughly = least(np.arange(len(rays)), BEFORE_M[::COARSE])
    clear = roughly > APART_M
    # A distance changes by no more than the step along the ray, so positions in between matter only near an object.
    unsure = np.flatnonzero(clear & (roughly < APART_M + COARSE * STEP_M))
    clear[unsure] = least(unsure, BEFORE_M) > APART_M
    return clear


def _colors(patch: Patch, T_floor_camera: SE3) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which pixels (n,) have the floor's colour, and which are of steel."""
    color = patch.color.reshape(-1, 3).astype(np.float64)
    light = color.sum(axis=1)
    share = color / np.maximum(light, 1.0)[:, None]
    floor = np.abs(T_floor_camera.apply(patch.points_m.reshape(-1, 3))[:, 2]) < ON_FLOOR_M
    if not floor.any():
        return np.zeros(len(color), dtype=bool), np.zeros(len(color), dtype=bool)
    like = np.abs(share - np.median(share[floor], axis=0)).max(axis=1) < UNLIKE
    lit = light > DARK * np.median(light[floor])
    grey = np.ptp(color, axis=1) < GREY * color.max(axis=1)
    return lit & like, lit & ~like & grey


def _normal_equations(
    evidence: _Evidence, T_camera_needle: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return information (6, 6) and gradient (6,) of the fit's cost at a pose, and the residuals of the points."""
    T = T_camera_needle.inverse()
    behind, by_behind = _behind(evidence.points, T, arc)
    missed, by_missed = _closest(evidence.through, T, arc)
    entered, by_entered = _closest(evidence.past, T, arc)
    left = float(1.48 * np.median(np.abs(behind))) if len(behind) else np.inf
    missed, entered = np.maximum(missed, 0.0), np.minimum(entered, 0.0)
    ray_sd_m = RAY_SD_PX * evidence.pixel_m
    residual = np.concatenate([behind / POINT_SD_M, missed / ray_sd_m, entered / ray_sd_m])
    slopes = np.concatenate(
        [
            by_behind / POINT_SD_M,
            np.where(missed[:, None] > 0.0, by_missed, 0.0) / ray_sd_m,
            np.where(entered[:, None] < 0.0, by_entered, 0.0) / ray_sd_m,
        ]
    )
    weighed = slopes.T / (1.0 + (residual / ROBUST) ** 2) / TOGETHER
    return weighed @ slopes, weighed @ residual, left


def _missed_by(evidence: _Evidence, T_camera_needle: SE3, arc: NeedleArc) -> float:
    """Return how badly a pose explains which rays meet the wire and which pass it; comparable for the same evidence."""
    T = T_camera_needle.inverse()
    missed, entered = np.maximum(_closest(evidence.through, T, arc)[0], 0.0), _closest(evidence.past, T, arc)[0]
    off = np.concatenate([missed, np.minimum(entered, 0.0)]) / (RAY_SD_PX * evidence.pixel_m)
    return float(np.log1p((off / ROBUST) ** 2).sum())


def _unexplained(evidence: _Evidence, T_camera_needle: SE3, arc: NeedleArc) -> float:
    """Return the number of rays that contradict a pose, as a share of those that meet steel."""
    T = T_camera_needle.inverse()
    missed, entered = _closest(evidence.through, T, arc)[0], _closest(evidence.past, T, arc)[0]
    within_m = -0.25 * arc.wire_m
    return float((missed > ASIDE_M).sum() + (entered < within_m).sum()) / max(1, len(missed))


def _behind(
    points: NDArray[np.float64], T_needle_camera: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far (n,) points lie behind the wire's front as seen along their rays, and the derivatives (n, 6).

    It is measured along the rays, because depth scatters along them, and converted to a distance across the wire. A
    point's distance from the surface would not do: points that scatter through the thin wire come out at its back.
    """
    p = T_needle_camera.apply(points)
    ray = p - T_needle_camera.translation_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    angle = arc.behind_tip_rad(p)
    middle, along = arc.point_m(angle), arc.tangent(angle)
    slant = square = back = np.zeros(len(p))
    for _ in range(2):  # to where the ray is nearest to the wire's middle line
        slant = np.sum(ray * along, axis=1)
        gap = p - middle
        square = np.maximum(1.0 - slant**2, STEEP**2)
        back = (np.sum(ray * gap, axis=1) - slant * np.sum(along * gap, axis=1)) / square
        angle = arc.behind_tip_rad(p - back[:, None] * ray)
        middle, along = arc.point_m(angle), arc.tangent(angle)
    aside = np.linalg.norm(p - back[:, None] * ray - middle, axis=1)
    front = np.sqrt(np.maximum((0.5 * arc.wire_m) ** 2 - aside**2, 0.0))
    across = ray - slant[:, None] * along
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    told = (square > STEEP**2) & (angle > 0.0) & (angle < arc.arc_rad)
    behind = back * np.sqrt(square) + front
    by = -np.concatenate([across, np.cross(middle, across)], axis=1)
    return behind[told], np.asarray(by[told], dtype=np.float64)


def _closest(
    places: NDArray[np.float64], T_needle_camera: SE3, arc: NeedleArc
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least distances (n,) along rays from the wire's surface, and their derivatives (n, 6)."""
    if not len(places):
        return np.zeros(0), np.zeros((0, 6))
    local = T_needle_camera.apply(places)
    distance = arc.distance_m(local.reshape(-1, 3)).reshape(local.shape[:2])
    return arc.slopes(local[np.arange(len(local)), distance.argmin(axis=1)])
