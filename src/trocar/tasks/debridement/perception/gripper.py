"""Pose and opening of a gripper from the marks on its fingers (Kehoe 2014, V-A.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.arms.instrument import FingerMarks, Instrument
from trocar.geometry import SE3
from trocar.perception.depth import distort, project
from trocar.perception.image import Intrinsics, StereoImage, StereoRig
from trocar.tasks.debridement.perception.marks import (
    JAW_RANGE,
    Fit,
    Spot,
    fit_marks,
    mark_points_m,
    pair_blobs,
    rough_fit,
    seen_blobs,
    tip_from_finger,
)

MIN_MARKS, MIN_SPOTS = 3, 6  # with fewer, a direction is undetermined, or hardly anything would reveal a wrong pose
ROUGH_PX, FINAL_PX, FOCAL_PX = 5.0, 0.7, 1600.0
"""Maximum RMS distance of the spots from the marks, at this focal length: before and after occlusions are known."""
MAX_SD_M, MAX_SD_RAD = 0.6e-3, np.radians(4.0)  # a pose that the spots determine less precisely is rejected
HIDDEN = (0.4, 0.6, 0.75, 0.75)
"""A spot with less than this share of its area in the drawing is partly hidden by something else; one value per
drawing, since the first drawings are of poses that are not accurate yet."""
FINE, SETTLED = (1.0, 1.0, 2.0, 2.0), 1e-2
"""Pixels of each drawing per pixel of the picture, at that focal length: the gripper is drawn from a better pose each
time. Once the pose changes by less than the second value (m and rad), occlusions by the fingers no longer change."""
SIDES = 10  # number of sides of the prism that represents a mark
NEAREST_M, LARGEST_PX = 1e-2, 1200  # a drawing that would be nearer or larger belongs to an impossible pose


@dataclass(frozen=True, eq=False)
class SeenGripper:
    """A gripper as found from the marks on its fingers."""

    T_world_tip: SE3  # pose of the controlled point between the jaws, as the arm's model has it
    jaw_rad: float  # opening of the jaws


def find_gripper(image: StereoImage, T_world_camera: SE3, arm: ArmModel) -> SeenGripper | None:
    """Return pose and opening of an arm's gripper, or None if fewer than three marks are seen or they contradict.

    The marks' middles are fitted to the spots first. Then the gripper is drawn in this pose. The drawing shows which
    parts of the marks the fingers hide, and so the offset of each spot's middle from its mark's; the fit is repeated
    with these offsets removed. A spot partly hidden by something else has less area than its drawing, and is left out.
    """
    marks = arm.instrument.marks
    if marks is None:
        return None
    options = [pair_blobs(image.rig, left, right, marks) for left, right in seen_blobs(image, marks)]
    up = T_world_camera.rotation.matrix[2]
    for pairs in product(*options):
        if sum(map(len, pairs)) < MIN_MARKS:
            continue
        fits = []
        for order in product((0, 1), repeat=2):
            # 1 takes a finger's far mark first
            named = {
                2 * finger + (number ^ order[finger]): pair
                for finger, found in enumerate(pairs)
                for number, pair in enumerate(found)
            }
            rough = rough_fit(named, marks, arm.tip_length_m)
            if rough is not None:
                spots = [
                    Spot(mark, right, blob, blob.middle_px)
                    for mark, pair in named.items()
                    for right, blob in ((False, pair.left), (True, pair.right))
                ]
                fit = fit_marks(spots, image.rig, marks, arm.tip_length_m, rough)
                if _credible(fit, image.rig, ROUGH_PX):
                    fits.append((fit, spots))
        # closed jaws look the same from both ends, but jaws hang down from their arm
        hanging = [found for found in fits if up @ found[0].T_camera_tip.rotation.matrix[:, 2] > 0]
        for fit, spots in sorted(hanging, key=lambda found: found[0].residual_px):
            best = _refined(fit, spots, image.rig, arm)
            if best is not None:
                return SeenGripper(T_world_camera @ best.T_camera_tip, best.jaw_rad)
    return None


def _credible(fit: Fit, rig: StereoRig, limit_px: float) -> bool:
    within = fit.residual_px <= limit_px * max(rig.left.fx / FOCAL_PX, 0.5)
    return within and bool(JAW_RANGE[0] <= fit.jaw_rad <= JAW_RANGE[1])


def _refined(fit: Fit, spots: Sequence[Spot], rig: StereoRig, arm: ArmModel) -> Fit | None:
    """Return the fit to spots corrected for occlusion by the fingers, without spots that something else hides."""
    marks, tip_length_m = arm.instrument.marks, arm.tip_length_m
    assert marks is not None  # spots have been found
    finer = max(1.0, FOCAL_PX / rig.left.fx)
    for number, (fine, least) in enumerate(zip(FINE, HIDDEN, strict=True)):
        centers = fit.T_camera_tip.apply(mark_points_m(marks, tip_length_m, fit.jaw_rad))
        better = []
        for right, lens, T_left_eye in ((False, rig.left, SE3.identity()), (True, rig.right, rig.T_left_right)):
            T_eye_left = T_left_eye.inverse()
            T_eye_tip = T_eye_left @ fit.T_camera_tip
            drawing = draw_marks(arm.instrument, tip_length_m, lens, T_eye_tip, fit.jaw_rad, fine * finer)
            if drawing is None:
                return None
            middles, pixel_area = project(lens, T_eye_left.apply(centers)), 1.0 / (fine * finer) ** 2
            mine = [spot for spot in spots if spot.right == right]
            better += [_compared(spot, drawing, pixel_area, middles[spot.mark], least) for spot in mine]
        known = [spot for spot in better if spot is not None]
        if len(known) < MIN_SPOTS or len({spot.mark for spot in known}) < MIN_MARKS:
            return None
        before, fit = fit, fit_marks(known, rig, marks, tip_length_m, fit)
        if fit.sd_m > MAX_SD_M or fit.sd_rad > MAX_SD_RAD:
            return None
        if np.abs((before.T_camera_tip.inverse() @ fit.T_camera_tip).log()).max() < SETTLED and number >= 2:
            break
    return fit if _credible(fit, rig, FINAL_PX) else None


def _compared(
    spot: Spot, drawing: list[NDArray[np.float64]], pixel_area: float, center_px: NDArray[np.float64], least: float
) -> Spot | None:
    """Return a spot with the middle of its mark, or None if it looks unlike its drawing."""
    drawn, merged = drawing[spot.mark], spot.blob.merged_px
    middle, area = spot.blob.middle_px, spot.blob.area_px
    if not len(drawn):
        return None
    if merged is not None:
        neighbour = drawing[spot.mark ^ 1]
        if not len(neighbour):
            return None
        # cut the seen and the drawn spot along the same line
        own, other = drawn.mean(0), neighbour.mean(0)
        both = np.concatenate([drawn, neighbour])
        seen, drawn = (pixels[(pixels - (own + other) / 2) @ (own - other) > 0] for pixels in (merged, both))
        if not len(seen) or not len(drawn):
            return None
        middle, area = seen.mean(0), float(len(seen))
    share = area / (len(drawn) * pixel_area)
    if not least <= share <= 1 / least:
        return None
    return replace(spot, middle_px=middle + center_px - drawn.mean(0))


class _Faces(NamedTuple):
    """Flat faces of both fingers and their marks, jaws closed."""

    corners_m: NDArray[np.float64]  # (n, 3) of all faces one after another, in their finger's frame
    ends: NDArray[np.intp]  # (faces,) where each face's corners end
    normals: NDArray[np.float64]  # (faces, 3) outward
    side: NDArray[np.intp]  # (faces,) +1 of the left finger, -1 of the right one
    mark: NDArray[np.intp]  # (faces,) number of the mark, -1 for a finger


@lru_cache(maxsize=16)
def _faces(shape: Instrument, marks: FingerMarks) -> _Faces:
    """Return the faces of an instrument's fingers and marks."""
    faces, normals, sides, numbers = [], [], [], []
    turn = np.arange(SIDES) * 2 * np.pi / SIDES
    # of the area of the round disc
    radius = marks.radius_m * np.sqrt(2 * np.pi / (SIDES * np.sin(2 * np.pi / SIDES)))
    half = 0.5 * shape.finger_width_m + marks.proud_m
    for finger, side in enumerate((1, -1)):
        prisms = [(shape.finger_m(side).reshape(-1, 2, 3), -1)]
        for k, center in enumerate(marks.centers_m(side, 0.0)):
            rim = center + radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SIDES)])
            prisms.append((np.stack([rim - [0, 0, half], rim + [0, 0, half]], axis=1), 2 * finger + k))
        for prism, mark in prisms:
            walls = [np.concatenate([prism[i - 1], prism[i][::-1]]) for i in range(len(prism))]
            for face in (prism[:, 0], prism[:, 1], *walls):
                normal = np.cross(face[1] - face[0], face[2] - face[0])
                outward = np.sign(normal @ (face[0] - prism.mean((0, 1))))
                faces.append(face)
                normals.append(normal * outward / np.linalg.norm(normal))
                sides.append(side)
                numbers.append(mark)
    ends = np.cumsum([len(face) for face in faces])
    return _Faces(np.concatenate(faces), ends, np.array(normals), np.array(sides), np.array(numbers))


def draw_marks(
    shape: Instrument, tip_length_m: float, lens: Intrinsics, T_eye_tip: SE3, jaw_rad: float, fine: float
) -> list[NDArray[np.float64]] | None:
    """Return u, v (n, 2) of each mark's visible pixels as an eye sees a gripper, or None for an impossible pose.

    The controlled point is ``tip_length_m`` beyond the jaw axis; a pixel of the picture is ``fine`` x ``fine`` pixels.
    """
    if shape.marks is None:
        return None
    faces = _faces(shape, shape.marks)
    of_corner = np.repeat(faces.side, np.diff(faces.ends, prepend=0))
    corners = T_eye_tip.apply(tip_from_finger(_opened(faces.corners_m, of_corner, jaw_rad), tip_length_m))
    normals = T_eye_tip.rotation.apply(tip_from_finger(_opened(faces.normals, faces.side, jaw_rad), 0.0))
    if (corners[:, 2] < NEAREST_M).any():
        return None
    pixels = distort(lens, corners[:, :2] / corners[:, 2:]) * [lens.fx, lens.fy]
    first = np.floor(pixels.min(0)) - 1
    wide, high = (fine * (np.ceil(pixels.max(0)) + 1 - first)).astype(int)
    if max(wide, high) > LARGEST_PX:
        return None
    focal = np.array([lens.fx, lens.fy])
    rays = (first / focal, 1 / focal / fine)
    owner = _drawn(faces, (pixels - first) * fine, corners, normals, (high, wide), rays)
    v, u = np.nonzero(owner >= 0)
    marks, places = owner[v, u], np.column_stack([u, v]) / fine + first + [lens.cx, lens.cy]
    return [places[marks == mark] for mark in range(4)]


def _opened(points: NDArray[np.float64], side: NDArray[np.intp], jaw_rad: float) -> NDArray[np.float64]:
    """Return points or directions (n, 3) of closed fingers, moved to this opening of the jaws."""
    half = 0.5 * side * jaw_rad
    cos, sin = np.cos(half), np.sin(half)
    x, y, z = points.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def _drawn(
    faces: _Faces,
    fine_px: NDArray[np.float64],
    corners_m: NDArray[np.float64],
    normals: NDArray[np.float64],
    size: tuple[int, int],
    rays: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.int8]:
    """Return the mark that is in front in each pixel of the drawing; -1: a finger, -2: nothing.

    ``rays`` are x/z, y/z of the first pixel and the step from pixel to pixel; accurate enough for occlusions.
    """
    owner = np.full(size, -2, dtype=np.int8)
    nearness = np.zeros(size)
    begins = faces.ends - np.diff(faces.ends, prepend=0)
    facing = np.flatnonzero(np.einsum("ij,ij->i", normals, corners_m[begins]) < 0)
    for face in facing:
        begin, end = begins[face], faces.ends[face]
        outline = fine_px[begin:end]
        u0, v0 = np.maximum(np.floor(outline.min(0)).astype(int), 0)
        u1, v1 = np.ceil(outline.max(0)).astype(int) + 1
        part = np.zeros((v1 - v0, u1 - u0), dtype=np.uint8)
        cv2.fillConvexPoly(part, np.rint(16 * (outline - [u0, v0])).astype(np.int32), 1, shift=4)
        here = nearness[v0:v1, u0:u1]
        part = part[: here.shape[0], : here.shape[1]]
        # 1/z is linear in x/z and y/z on a plane
        nx, ny, nz = normals[face] / (normals[face] @ corners_m[begin])
        x = rays[0][0] + rays[1][0] * np.arange(u0, u0 + here.shape[1])
        y = rays[0][1] + rays[1][1] * np.arange(v0, v0 + here.shape[0])
        inverse = (nx * x + nz)[None, :] + (ny * y)[:, None]
        front = (part > 0) & (inverse > here)
        here[front] = inverse[front]
        owner[v0:v1, u0:u1][front] = faces.mark[face]
    return owner
