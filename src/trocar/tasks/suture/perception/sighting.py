"""Where a needle is, from depth images of one moment.

Points on the needle have to lie on its wire. A pixel that does not have the colour of the floor under the needle shows
the wire, so its ray has to meet it; a ray that ends on the floor, by its colour or its depth, must not have passed
through it. The wire is about two pixels wide and its depth scatters by most of its thickness: its place across the rays
comes from the colours, its distance from the mean of many points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.tasks.suture.perception.arc import NeedleArc
from trocar.tasks.suture.perception.evidence import Elsewhere, Evidence, gather
from trocar.tasks.suture.perception.residuals import missed_by, normal_equations, unexplained

FIRST_M, THEN_M = 2.5e-3, 1.3e-3
"""Points this close to the wire are taken for points on it: first of the expected wire, then of the one found."""
WIDE_M = 5.0e-3
"""Points this close to the expected wire decide between the results from several starts."""
SURE_M, AWAY, FAR_AWAY = 0.8e-3, 1.5, 3.0
"""If the wire's end is less certain than this (SD), the search starts from several poses, this many SDs away from the
expected one; if the result does not explain what is seen, it starts again even further away."""
UNEXPLAINED = 0.1
"""Pixels of steel within ``WIDE_M`` whose rays pass the wire far aside show another place of it, as those of the floor
do whose rays go through it. Where there are more of them than this share of those that show steel, the pose is not the
needle's. (In the cell there is none of them about a needle that was found, and a fifth about one that was not.)"""
SEARCH_PIXEL_M = 0.25e-3
"""While searching, pixels that are closer to each other on the needle than this are left out."""
STEPS = 12
MOST_SHIFT_M, MOST_TURN_RAD = 0.5e-3, 0.1
"""Greatest step of the search."""
WORST_M = 0.9e-3
"""Points that scatter about the wire by more than this (SD) are not on it."""


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

    def gathered(at: SE3, near_m: float, every: int = 1) -> Evidence | None:
        return gather(images, at, arc, near_m, T_camera_floor, elsewhere, every)

    def fitted(evidence: Evidence, at: SE3) -> tuple[SE3, NDArray[np.float64], float]:
        information, left = np.zeros((6, 6)), 0.0
        for _ in range(STEPS):
            information, gradient, left = normal_equations(evidence, at, arc)
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
            first.sort(key=lambda at: missed_by(wide, at, arc))
        evidence = gathered(first[0], THEN_M) if first else None
        if evidence is None:
            return None
        at, information, left = fitted(evidence, first[0])
        around = gathered(at, WIDE_M, sparsely)
        if left > WORST_M or around is None or unexplained(around, at, arc) > UNEXPLAINED:
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
            likeliest = covariance @ lever.T @ axis / np.sqrt(variance)  # twist that has the tip one SD away along it
            starts += [T_camera_needle @ SE3.exp(share * likeliest) for share in (away, -away)]
    return starts
