"""Red fragments in both eyes (Kehoe 2014, V-A.1)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.perception.color import RED_FOAM, to_hsv
from trocar.perception.depth import rays_through
from trocar.perception.image import StereoImage
from trocar.perception.stereo import disparity_map, rectify
from trocar.tasks.debridement.perception import regions
from trocar.tasks.debridement.perception.regions import MIN_AREA_M2, Region, shifted_onto

SAME_M = 0.010  # two places this close, seen from above, are the same fragment
MIDDLE_M = 3.8e-3  # assumed height of the middle of a fragment on the table, before it has been measured
MIDDLE_OF_MEAN = 0.6e-3, 0.54
"""Height of a fragment's middle from the mean height of its visible surface, constant and factor: a fit to random
convex pieces with flat bottoms, which scatter about it by .2 mm."""
USUAL_MEAN_M = 5.9e-3  # mean height of the visible surface, if it cannot be measured
BACK_M = 0.2e-3  # the middle of such a piece is this much farther from the eyes than the middle of its outline
LYING_M = 11e-3  # mean height of the visible surface above which a fragment is not on the table
BEHIND_M = 2.2e-3  # distance of a fragment's middle behind the mean of its visible surface
SINGLE_M2 = 75e-6
"""Largest outline of a single fragment with a notch: ragged foam is not two fragments, nor is one behind a finger."""
LARGEST_M2, LONGEST_M = 150e-6, 20e-3  # largest outline of one fragment; larger ones are several
NOTCH_M = 0.7e-3
SOLID = 0.93
ALIKE = 0.85  # if the ratio of the areas in both eyes is below this, one of them sees only a part
COMMON = 0.6
"""Share of the smaller outline that must overlap the other once both are shifted by the surface's disparity."""
MIN_MATCHES = 25
RIM_M = 0.35e-3  # this close to the outline, the matched windows also see the table
WINDOW_M, WINDOW_PX = 1.7e-3, 7  # width of the matched windows, and least width


@dataclass(frozen=True, eq=False)
class SeenFragment:
    """One fragment, or a heap of them that cannot be told apart."""

    p_world_m: NDArray[np.float64]  # (3,) best estimate of its centre of volume
    extent_m: NDArray[np.float64]  # (2,) long and short extent, seen from above
    yaw_rad: float  # direction of the long extent in the world's x-y plane, [0, pi)
    height_m: float  # of its middle above the table
    area_px: int  # of its pixels in the left picture

    @property
    def rim_m(self) -> NDArray[np.float64]:
        """Return the corners (4, 3) in the world of a rectangle of its extents about its middle, in order."""
        along = np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0]) * self.extent_m[0] / 2
        across = np.array([-np.sin(self.yaw_rad), np.cos(self.yaw_rad), 0.0]) * self.extent_m[1] / 2
        return self.p_world_m + [along + across, along - across, -along - across, across - along]

    def away_m(self, p_world_m: NDArray[np.float64]) -> float:
        """Return how far it is from a place (3,), seen from above."""
        return float(np.linalg.norm(self.p_world_m[:2] - p_world_m[:2]))


@dataclass(frozen=True, eq=False)
class TableView:
    """A rectified pair over a table, and the pose of its left eye."""

    image: StereoImage
    T_table_camera: SE3
    T_world_table: SE3

    def meet(self, pixels: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
        """Return where the left eye's rays through pixels (..., 2) reach a height above the table, in its frame."""
        turned = self.T_table_camera.rotation.apply(rays_through(self.image.rig.left, pixels))
        eye = self.T_table_camera.translation_m
        return eye + turned * ((height_m - eye[2]) / turned[..., 2])[..., None]

    def point(self, pixels: NDArray[np.float64], disparity_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (..., 3) in the table's frame of pixels of the left eye at a disparity."""
        rig = self.image.rig
        ahead = rig.left.fx * rig.T_left_right.translation_m[0] / (disparity_px - rig.left.cx + rig.right.cx)
        return self.T_table_camera.apply(rays_through(rig.left, pixels) * ahead[..., None])

    def plane(self, pixel: NDArray[np.float64], height_m: float) -> float:
        """Return the disparity at a pixel of a plane at this height above the table."""
        a, b, c = regions.plane_disparity(self.image.rig, self.T_table_camera, height_m)
        return float(a * pixel[0] + b * pixel[1] + c)

    def pixel_m(self, pixel: NDArray[np.float64]) -> float:
        """Return how wide a pixel of the left eye is on the table, across its view."""
        lens, T = self.image.rig.left, self.T_table_camera
        return float(T.translation_m[2] / -T.rotation.apply(rays_through(lens, pixel))[2]) / lens.fx


def find_fragments(image: StereoImage, T_world_camera: SE3, T_world_table: SE3) -> list[SeenFragment]:
    """Return the fragments that both eyes see, on the table, in the receptacle or held."""
    image, R_left_rectified = rectify(image)
    T_table_camera = T_world_table.inverse() @ T_world_camera @ SE3.from_parts(R_left_rectified)
    view = TableView(image, T_table_camera, T_world_table)
    masks = [RED_FOAM.mask(to_hsv(picture)) for picture in (image.left, image.right)]
    found = []
    for left, right in regions.group_regions(masks, image.rig, T_table_camera, MIDDLE_M):
        found += [_fragment(view, one, other) for one, other in _singles(view, left, right)]
    return [fragment for fragment in found if fragment is not None]


def _singles(view: TableView, left: Region, right: Region) -> list[tuple[Region, Region]]:
    """Return what both eyes see of each fragment in a group, or the group if it cannot be cut.

    Both outlines are superimposed: a notch in both is between two fragments; a notch in one eye only is from a finger.
    """
    partly = min(left.area_px, right.area_px) <= ALIKE * max(left.area_px, right.area_px)
    disparity = view.plane(left.middle_px, MIDDLE_M) if partly else float(left.middle_px[0] - right.middle_px[0])
    both = left.mask | shifted_onto(left, right, disparity)
    pixel_m = view.pixel_m(left.middle_px)
    v, u = np.nonzero(both)
    outline = cv2.convexHull(np.column_stack([u, v]).astype(np.int32))
    hull_m2 = cv2.contourArea(outline) * pixel_m**2
    long_m = max(cv2.minAreaRect(outline)[1]) * pixel_m
    if hull_m2 < SINGLE_M2 or (regions.solidity(both) > SOLID and hull_m2 < LARGEST_M2 and long_m < LONGEST_M):
        return [(left, right)]
    found = []
    for part in regions.split_convex(both, NOTCH_M / pixel_m, MIN_AREA_M2 / pixel_m**2):
        one = left.mask & part
        other = right.mask & shifted_onto(right, Region(part, left.corner_px), -disparity)
        if one.any() and other.any():
            found.append((Region(one, left.corner_px), Region(other, right.corner_px)))
    return found


def _depth(view: TableView, left: Region, right: Region) -> tuple[float, float] | None:
    """Return disparity in px and mean height above the table of an object's visible part; None if the eyes disagree.

    It is searched for on the table first, then up to carrying height. An object too smooth or too small to be matched
    can only be on the table.
    """
    wide, high = left.mask.shape[::-1]
    corners = np.array(left.corner_px) + np.array([[0, 0], [wide, 0], [0, high], [wide, high]], dtype=np.float64)
    lowest = min(view.plane(corner, -1e-3) for corner in corners)
    least = COMMON * min(left.area_px, right.area_px)

    def agrees(disparity: float) -> bool:
        return bool(np.count_nonzero(left.mask & shifted_onto(left, right, disparity)) >= least)

    for top_m in (1.3 * LYING_M, regions.HIGHEST_M):
        matched = _matched(view, left, (lowest, max(view.plane(corner, top_m) for corner in corners)))
        if matched is not None and agrees(disparity := float(np.median(matched[1]))):
            return disparity, float(view.point(*matched)[:, 2].mean())
    disparity = view.plane(left.middle_px, MIDDLE_M)
    return (disparity, USUAL_MEAN_M) if agrees(disparity) else None


def _matched(
    view: TableView, left: Region, disparity_px: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the pixels (n, 2) of the left region away from its rim that are matched, and their disparities (n,)."""
    image, (u, v), (high, wide), pixel_m = view.image, left.corner_px, left.mask.shape, view.pixel_m(left.middle_px)
    window = max(2 * round(0.5 * WINDOW_M / pixel_m) + 1, WINDOW_PX)
    found = disparity_map(image.left[..., 0], image.right[..., 0], (u, v, wide, high), disparity_px, window)
    rim = max(1, round(RIM_M / pixel_m))
    framed = cv2.copyMakeBorder(left.mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    inner = cv2.erode(framed, np.ones((3, 3), np.uint8), iterations=rim)
    good = np.isfinite(found) & (inner[1:-1, 1:-1] > 0)
    if good.sum() < max(MIN_MATCHES, 0.2 * np.count_nonzero(inner)):
        return None
    rows, columns = np.nonzero(good)
    return np.column_stack([columns + u, rows + v]).astype(np.float64), found[good]


def _fragment(view: TableView, left: Region, right: Region) -> SeenFragment | None:
    depth = _depth(view, left, right)
    if depth is None:
        return None
    disparity, mean_m = depth
    partly = min(left.area_px, right.area_px) < ALIKE * max(left.area_px, right.area_px)
    whole, middle = left, left.middle_px
    if partly or left.pieces + right.pieces > 2:  # something hides a part of it
        whole = left.united(right, disparity)
        middle = whole.hull_middle_px
    if mean_m < LYING_M:
        p_table = view.meet(middle, MIDDLE_OF_MEAN[0] + MIDDLE_OF_MEAN[1] * mean_m)
        away = p_table[:2] - view.T_table_camera.translation_m[:2]
        p_table[:2] += BACK_M * away / max(float(np.linalg.norm(away)), 1e-9)
    else:
        p_table = view.point(middle, np.array(disparity))
        ray = p_table - view.T_table_camera.translation_m
        p_table = p_table + BEHIND_M * ray / np.linalg.norm(ray)
    outline = 1e3 * view.meet(whole.hull_px, float(p_table[2]))[:, :2]
    _, size, angle = cv2.minAreaRect(outline.astype(np.float32))
    along = np.radians(angle) + (np.pi / 2 if size[1] > size[0] else 0.0)
    direction = view.T_world_table.rotation.apply(np.array([np.cos(along), np.sin(along), 0.0]))
    return SeenFragment(
        p_world_m=view.T_world_table.apply(p_table),
        extent_m=1e-3 * np.sort(size)[::-1],
        yaw_rad=float(np.arctan2(direction[1], direction[0]) % np.pi),
        height_m=float(p_table[2]),
        area_px=int(left.area_px),
    )
