"""Estimate a needle's pose from depth images of one moment, by a robust fit to points and rays.

Depth points on the needle have to lie on its wire. A pixel with the colour of steel shows the wire, so its ray has to
meet the wire. A ray that ends on the floor, by its colour or its depth, must miss the wire. The wire is about two
pixels wide, and its depth scatters by most of its thickness. So its place across the rays comes from the colours, and
its distance from the mean of many points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.errors import InvalidValue
from trocar.geometry import SE3
from trocar.perception.depth import Patch, patch_around
from trocar.perception.image import RgbdImage
from trocar.tasks.suture.needle import Needle

FIRST_M, THEN_M = 2.5e-3, 1.3e-3
"""Pixels this close to the wire are the evidence of a fit: first of the expected wire, then of the wire found."""
WIDE_M = 5.0e-3
"""Rays this close to the expected wire decide between the results from several starts."""
SURE_M, AWAY, FAR_AWAY = 0.8e-3, 1.5, 3.0
"""If the SD of the tip's position exceeds ``SURE_M``, the search also starts ``AWAY`` SDs from the expected pose. If
the result does not explain what is seen, it starts again ``FAR_AWAY`` SDs from it."""
CONTRADICTED = 0.1
"""Two kinds of pixels within ``WIDE_M`` of the wire contradict a pose: steel whose ray misses the wire, and floor whose
ray passes through it. If their number exceeds this share of the steel pixels, the pose is rejected. (In the cell, there
are none around a needle that was found, and a fifth around one that was not.)"""
SEARCH_PIXEL_M = 0.25e-3
"""During the search, pixels are thinned to about this spacing on the needle."""
STEPS = 12
MOST_SHIFT_M, MOST_TURN_RAD = 0.5e-3, 0.1
"""Largest step of the fit."""
WORST_M = 0.9e-3
"""A fit whose points scatter about the wire by more than this (SD) is rejected."""
POINT_SD_M, RAY_SD_PX = 0.35e-3, 0.25
"""SDs of a point's distance from the wire, and of the distance by which a ray wrongly misses or enters the wire."""
ROBUST = 1.5
"""A residual of more SDs than this counts less (Cauchy)."""
TOGETHER = 4.0
"""This many neighbouring points and rays share their error and count as one; chosen so that the errors of looks in the
cell are as large as stated."""
STEEP = 0.4
"""If the sine of the angle between ray and wire is below this, depth tells nothing about the wire."""
ASIDE_M = 0.5e-3
"""A ray that meets steel but misses the wire by more than this contradicts the pose."""
MARGIN_M = 2.5e-3
"""Least margin around the needle that is read; it shows the floor's colour."""
BEHIND_M = 1.5e-3
"""A ray that ends this far behind the wire has missed it."""
FAR_BEHIND, FAR_BEHIND_M = 1.5, 4.0e-3
"""Steel that is seen this far behind the wire is not the wire, but an instrument: this many times the distance within
which pixels are the evidence, but at most ``FAR_BEHIND_M``."""
OVER_FLOOR_M = 0.7e-3
"""Points less than this above the floor are not on a needle. A ray says nothing by meeting the floor where the expected
wire is lower than this."""
ON_FLOOR_M = 1.0e-3
"""Points this close to the floor show its colour."""
APART_M, CLOSE_M = 1.0e-3, 0.5e-3
"""Rays that pass another known object this close may show that object: all rays within ``CLOSE_M``; within ``APART_M``,
rays that meet steel and are nearer to the object than to the wire."""
IN_FRONT_M = 1.5e-3
"""A point hides the wire if it is this much nearer to the camera than the wire can be."""
BEHIND_WIRE_M, BEFORE_WIRE_M = 2.5e-3, 80e-3
"""An object between these distances behind and before the wire would hide it, or be taken for it."""
STEP_M = 0.75e-3
"""Least step along a ray in the search for such objects; steps are longer where none is near."""
UNLIKE = 0.05
"""Colours are alike if their shares of red, green and blue differ by less than this."""
GREY = 0.25
"""Steel has a lower saturation than this."""
DARK = 0.12
"""Pixels with less than this share of the floor's light are in shadow and show no colour."""
SPACING_M, WIRE_SPACING_M = 0.4e-3, 0.1e-3
"""Spacing at which rays and the wire are sampled."""
FEWEST, DEEP = 12, 0.4
"""Minimum number of pixels on the wire for it to count as seen; this share of it is the minimum number of depth points
on the wire, over all images."""

Distances = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signed distances (n,) of points (n, 3) in the camera's frame from other known objects."""


@dataclass(frozen=True, eq=False)
class NeedleSighting:
    """A Gaussian likelihood of the needle's pose.

    Attributes:
        T_camera_needle: pose that fits best.
        information: (6, 6) inverse covariance of a twist of the needle in its own frame about that pose, m and rad.
        pixels: number of pixels that show the wire.
        depth_sd_m: robust SD of the wire's depth.
    """

    T_camera_needle: SE3
    information: NDArray[np.float64]
    pixels: int
    depth_sd_m: float


def sight_needle(
    images: Sequence[RgbdImage],
    T_camera_needle: SE3,
    covariance: NDArray[np.float64],
    needle: Needle,
    T_camera_floor: SE3,
    occluders: Distances | None = None,
) -> NeedleSighting | None:
    """Return what depth images of one moment tell about a needle's pose; None if the needle is not seen.

    Args:
        images: images with depth from one camera, while nothing moves; more images reduce the scatter of depth.
        T_camera_needle: expected pose.
        covariance: (6, 6) of a twist of the needle in its own frame about that pose, m and rad; it determines where the
            search begins, constrains it where the images show nothing, and is not part of the returned information.
        needle: the needle's shape.
        T_camera_floor: a plane, z up, below which nothing of the needle is seen.
        occluders: distances of points from other known objects, such as the instrument that holds it; None: there are
            none.

    Raises:
        InvalidValue: there is no image.
    """
    if not images:
        raise InvalidValue("the number of images of a needle", 0, "give one or more")
    fit = _PoseFit(images, T_camera_needle, np.linalg.inv(covariance), needle, T_camera_floor, occluders)
    starts = search_starts(T_camera_needle, covariance, needle)
    found = fit.search(starts)
    if found is None and len(starts) > 1:
        found = fit.search([T_camera_needle, *search_starts(T_camera_needle, covariance, needle, FAR_AWAY)[1:]])
    return found


def floor_height_m(
    images: Sequence[RgbdImage], T_camera_needle: SE3, needle: Needle, T_camera_floor: SE3
) -> float | None:
    """Return the height of the floor around a needle over its assumed plane (z up), to .01 mm; None if unseen."""
    T_floor, half, found = T_camera_floor.inverse(), needle.radius_m + MARGIN_M, [np.zeros(0)]
    for image in images:
        if (patch := patch_around(image, T_camera_needle, [-half] * 3, [half] * 3)) is not None:
            z = T_floor.apply(patch.points_m.reshape(-1, 3))[:, 2]
            found.append(z[colors(patch, T_floor)[0] & (np.abs(z) < ON_FLOOR_M)])
    heights = np.concatenate(found)
    return float(np.median(heights)) if len(heights) > FEWEST else None


@dataclass(frozen=True, eq=False)
class _PoseFit:
    """A pose to be fitted; see ``sight_needle``. ``prior`` is the inverse of the expected pose's covariance."""

    images: Sequence[RgbdImage]
    T_camera_needle: SE3
    prior: NDArray
    needle: Needle
    T_camera_floor: SE3
    occluders: Distances | None

    def search(self, starts: Sequence[SE3]) -> NeedleSighting | None:
        """Return the fit from the best of these starts; None if the images show no needle, or contradict it."""
        pixel_m = float(self.T_camera_needle.translation_m[2]) / self.images[0].intrinsics.fx
        every = max(1, round(SEARCH_PIXEL_M / pixel_m)) if pixel_m > 0.0 else 1
        near = [(start, found) for start in starts if (found := self._evidence(start, FIRST_M, every)) is not None]
        first = [self._fitted(found, start)[0] for start, found in near]
        if len(starts) > 1 and (wide := self._evidence(self.T_camera_needle, WIDE_M, every)) is not None:
            first.sort(key=lambda at: ray_cost(wide, at, self.needle))
        evidence = self._evidence(first[0], THEN_M) if first else None
        if evidence is None:
            return None
        at, information, depth_sd_m = self._fitted(evidence, first[0])
        around = self._evidence(at, WIDE_M, every)
        if depth_sd_m > WORST_M or around is None or contradicting_share(around, at, self.needle) > CONTRADICTED:
            return None
        return NeedleSighting(at, information, len(evidence.through), depth_sd_m)

    def _evidence(self, at: SE3, near_m: float, every: int = 1) -> NeedleEvidence | None:
        return gather_evidence(self.images, at, self.needle, near_m, self.T_camera_floor, self.occluders, every)

    def _fitted(self, evidence: NeedleEvidence, at: SE3) -> tuple[SE3, NDArray[np.float64], float]:
        """Return the pose that fits best near this one, its information, and the robust SD of the points' depth."""
        information, depth_sd_m = np.zeros((6, 6)), 0.0
        for _ in range(STEPS):
            information, gradient, depth_sd_m = normal_equations(evidence, at, self.needle)
            away = (self.T_camera_needle.inverse() @ at).log()
            step = np.linalg.solve(information + self.prior, -gradient - self.prior @ away)
            step /= max(1.0, np.abs(step[:3]).max() / MOST_SHIFT_M, np.abs(step[3:]).max() / MOST_TURN_RAD)
            at = at @ SE3.exp(step)
            if np.abs(step[:3]).max() < 1e-6 and np.abs(step[3:]).max() < 1e-4:
                break
        return at, information, depth_sd_m


def search_starts(
    T_camera_needle: SE3, covariance: NDArray[np.float64], needle: Needle, away: float = AWAY
) -> list[SE3]:
    """Return where the search for a needle starts: at the expected pose, and around it if the tip is uncertain.

    Arguments as for ``sight_needle``; the other starts are ``away`` SDs from the expected pose.
    """
    lever = np.column_stack([np.eye(3), np.cross(np.eye(3), needle.p_tip_m).T])
    variances, axes = np.linalg.eigh(lever @ covariance @ lever.T)
    starts = [T_camera_needle]
    for variance, axis in zip(variances, axes.T, strict=True):
        if variance > SURE_M**2:
            likeliest = covariance @ lever.T @ axis / np.sqrt(variance)  # twist that moves the tip by one SD along axis
            starts += [T_camera_needle @ SE3.exp(share * likeliest) for share in (away, -away)]
    return starts


def normal_equations(
    evidence: NeedleEvidence, T_camera_needle: SE3, needle: Needle
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return information (6, 6) and gradient (6,) of the fit's cost at a pose, and the robust SD of the points."""
    T = T_camera_needle.inverse()
    behind, by_behind = depth_residuals(evidence.points, T, needle)
    missed, by_missed = ray_distances(evidence.through, T, needle)
    entered, by_entered = ray_distances(evidence.past, T, needle)
    depth_sd_m = float(1.48 * np.median(np.abs(behind))) if len(behind) else np.inf
    # a ray counts only if it is on the wrong side of the wire's surface
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
    return weighed @ slopes, weighed @ residual, depth_sd_m


def ray_cost(evidence: NeedleEvidence, T_camera_needle: SE3, needle: Needle) -> float:
    """Return how badly a pose explains which rays meet and which miss the wire; comparable for the same evidence."""
    T = T_camera_needle.inverse()
    missed, entered = ray_distances(evidence.through, T, needle)[0], ray_distances(evidence.past, T, needle)[0]
    off = np.concatenate([np.maximum(missed, 0.0), np.minimum(entered, 0.0)]) / (RAY_SD_PX * evidence.pixel_m)
    return float(np.log1p((off / ROBUST) ** 2).sum())


def contradicting_share(evidence: NeedleEvidence, T_camera_needle: SE3, needle: Needle) -> float:
    """Return the number of rays that contradict a pose, as a share of those that meet steel."""
    T = T_camera_needle.inverse()
    missed, entered = ray_distances(evidence.through, T, needle)[0], ray_distances(evidence.past, T, needle)[0]
    within_m = -0.25 * needle.wire_m
    return float((missed > ASIDE_M).sum() + (entered < within_m).sum()) / max(1, len(missed))


def depth_residuals(
    points: NDArray[np.float64], T_needle_camera: SE3, needle: Needle
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far (n,) points lie behind the wire's front, and its derivatives (n, 6) by a twist of the needle.

    The distance is found along the rays, because depth scatters along them, and then taken across the wire. The
    distance from the wire's surface would not do: a point that scatters through the thin wire comes near its back.
    Points that tell nothing, beyond the wire's ends or where a ray is too steep, are left out.
    """
    p = T_needle_camera.apply(points)
    ray = p - T_needle_camera.translation_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    angle = needle.behind_tip_rad(p)
    middle, along = needle.point_m(angle), needle.tangent(angle)
    slant = square = back = np.zeros(len(p))
    for _ in range(2):  # find where the ray is nearest to the wire's centreline
        slant = np.sum(ray * along, axis=1)
        gap = p - middle
        square = np.maximum(1.0 - slant**2, STEEP**2)
        back = (np.sum(ray * gap, axis=1) - slant * np.sum(along * gap, axis=1)) / square
        angle = needle.behind_tip_rad(p - back[:, None] * ray)
        middle, along = needle.point_m(angle), needle.tangent(angle)
    aside = np.linalg.norm(p - back[:, None] * ray - middle, axis=1)
    front = np.sqrt(np.maximum((0.5 * needle.wire_m) ** 2 - aside**2, 0.0))
    across = ray - slant[:, None] * along
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    informative = (square > STEEP**2) & (angle > 0.0) & (angle < needle.arc_rad)
    behind = back * np.sqrt(square) + front
    by = -np.concatenate([across, np.cross(middle, across)], axis=1)
    return behind[informative], np.asarray(by[informative], dtype=np.float64)


def ray_distances(
    places: NDArray[np.float64], T_needle_camera: SE3, needle: Needle
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least distances (n,) of places (n, k, 3) along rays from the wire, and their derivatives (n, 6)."""
    if not len(places):
        return np.zeros(0), np.zeros((0, 6))
    local = T_needle_camera.apply(places)
    distance = needle.distance_m(local.reshape(-1, 3)).reshape(local.shape[:2])
    return needle.slopes(local[np.arange(len(local)), distance.argmin(axis=1)])


# What the images show.


@dataclass(frozen=True, eq=False)
class NeedleEvidence:
    """The evidence of images, in the camera's frame.

    Attributes:
        points: (n, 3) on the wire.
        through: (m, k, 3) positions along rays that meet the wire.
        past: (l, k, 3) positions along rays that miss it.
        pixel_m: distance between neighbouring rays at the needle.
    """

    points: NDArray[np.float64]
    through: NDArray[np.float64]
    past: NDArray[np.float64]
    pixel_m: float


def gather_evidence(
    images: Sequence[RgbdImage],
    T_camera_needle: SE3,
    needle: Needle,
    near_m: float,
    T_camera_floor: SE3,
    occluders: Distances | None,
    every: int,
) -> NeedleEvidence | None:
    """Return what images show within ``near_m`` of a needle at this pose; None if it is too little.

    Colours are taken from the first image, since the others have the same. One in ``every`` rows and columns is read.
    """
    half = np.array([needle.radius_m, needle.radius_m, 0.0]) + 0.5 * needle.wire_m + max(near_m, MARGIN_M)
    found = (patch_around(image, T_camera_needle, -half, half) for image in images)
    patches = [patch.thinned(every) for patch in found if patch is not None]
    if not patches:
        return None
    T_needle, T_floor = T_camera_needle.inverse(), T_camera_floor.inverse()
    rays = patches[0].rays.reshape(-1, 3)
    z_near, beside = along_rays(rays, T_camera_needle, needle, near_m)
    ours = beside < near_m  # rays near the wire, above the floor, that nothing hides
    above = np.zeros(len(rays), dtype=bool)
    above[ours] = T_floor.apply(rays[ours] * z_near[ours, None])[:, 2] > OVER_FLOOR_M
    depth = np.array([patch.depth_m.ravel() for patch in patches])
    ours &= np.nan_to_num(depth, nan=np.inf).min(axis=0) >= z_near - near_m - IN_FRONT_M
    shows_floor, shows_steel = colors(patches[0], T_floor)
    ours &= above | shows_steel  # what shows steel is above the floor, however deep the wire is expected
    if occluders is not None:
        apart = np.full(len(rays), np.inf)
        apart[ours] = clearance_m(occluders, rays[ours], z_near[ours])
        # near the jaws, steel is of the wire only if the wire is nearer
        ours &= (apart > CLOSE_M) & (~shows_steel | (apart > np.minimum(APART_M, CLOSE_M + beside)))
    far_behind = np.nan_to_num(depth, nan=-np.inf).max(axis=0) > z_near + min(FAR_BEHIND * near_m, FAR_BEHIND_M)
    through = ours & shows_steel & ~far_behind
    if through.sum() < FEWEST:
        return None
    points = (rays * depth[..., None])[:, through].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    on = (needle.distance_m(T_needle.apply(points)) < near_m) & (T_floor.apply(points)[:, 2] > OVER_FLOOR_M)
    if on.sum() < FEWEST * DEEP:
        return None
    past = ours & ~shows_steel & (shows_floor | (depth[0] > z_near + BEHIND_M))
    places = rays[:, None] * (z_near[:, None] + np.arange(-4, 5) * SPACING_M)[..., None]
    pixel_m = every * float(T_camera_needle.translation_m[2]) / images[0].intrinsics.fx
    return NeedleEvidence(points[on], places[through], places[past], pixel_m)


def along_rays(
    rays: NDArray[np.float64], T_camera_needle: SE3, needle: Needle, near_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the depth (n,) of the wire where rays (n, 3) are nearest to it, and their least distances (n,) from it.

    Rays that miss the wire by more than ``near_m`` have an infinite distance.
    """
    count = 2 + int(needle.radius_m * needle.arc_rad / WIRE_SPACING_M)
    wire = T_camera_needle.apply(needle.point_m(np.linspace(0.0, needle.arc_rad, count)))
    farthest = (near_m + 0.5 * needle.wire_m) / wire[:, 2].min()
    # the nearest point of the wire as projected to z = 1; that distance times the depth is in metres
    apart, place = KDTree(wire[:, :2] / wire[:, 2:]).query(rays[:, :2], distance_upper_bound=farthest)
    depth = wire[np.minimum(place, count - 1), 2]
    return depth, depth * apart - 0.5 * needle.wire_m


def clearance_m(occluders: Distances, rays: NDArray[np.float64], z_near: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least distances (n,) of rays (n, 3) from other objects that would hide the wire at these depths (n,).

    Near an object, places ``STEP_M`` apart are tried, so a distance of ``CLOSE_M`` from a corner comes out .13 mm too
    large at most. A ray that comes nearer than ``CLOSE_M`` is not followed further.
    """
    least = np.full(len(rays), np.inf)
    z, end, long = z_near + BEHIND_WIRE_M, z_near - BEFORE_WIRE_M, np.linalg.norm(rays, axis=1)
    left = np.arange(len(rays))
    while len(left):
        apart_m = occluders(rays[left] * z[left, None])
        least[left] = np.minimum(least[left], apart_m)
        going = (apart_m > CLOSE_M) & (z[left] > end[left])
        left, apart_m = left[going], apart_m[going]
        # sphere tracing: no object is nearer than its distance, so the ray is clear that far
        z[left] = np.maximum(z[left] - np.maximum(apart_m - APART_M, STEP_M) / long[left], end[left])
    return least


def colors(patch: Patch, T_floor_camera: SE3) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
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
