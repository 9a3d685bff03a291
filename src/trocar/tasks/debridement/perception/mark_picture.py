"""Appearance of a gripper's marks in a given pose: fingers hide parts of them, which shifts the spots' middles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from trocar.arms.instrument import FingerMarks, Instrument
from trocar.geometry import SE3
from trocar.perception.depth import distort
from trocar.perception.image import Intrinsics
from trocar.tasks.debridement.perception.marks import tip_from_finger

SIDES = 10  # number of sides of the prism that represents a mark
NEAREST_M, LARGEST_PX = 1e-2, 1200  # a drawing that would be nearer or larger belongs to an impossible pose


@dataclass(frozen=True, eq=False)
class _Faces:
    """Flat faces of both fingers and their marks, jaws closed."""

    corners_m: NDArray[np.float64]  # (n, 3) of all faces one after another, in their finger's frame
    ends: NDArray[np.intp]  # (faces,) where each face's corners end
    normals: NDArray[np.float64]  # (faces, 3) outward
    side: NDArray[np.intp]  # (faces,) +1 of the left finger, -1 of the right one
    mark: NDArray[np.intp]  # (faces,) number of the mark, -1 for a finger


@lru_cache(maxsize=16)
def _faces(shape: Instrument, marks: FingerMarks) -> _Faces:
    """Return the faces of an instrument's fingers and marks."""
    polygons, side_of, mark_of = [], [], []
    for finger, side in enumerate((1, -1)):
        solids = [(shape.finger_m(side).reshape(-1, 2, 3), -1)]
        turn = np.arange(SIDES) * 2 * np.pi / SIDES
        # of the area of the round disc
        radius = marks.radius_m * np.sqrt(2 * np.pi / (SIDES * np.sin(2 * np.pi / SIDES)))
        half = 0.5 * shape.finger_width_m + marks.proud_m
        for k, center in enumerate(marks.centers_m(side, 0.0)):
            rim = center + radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SIDES)])
            solids.append((np.stack([rim - [0, 0, half], rim + [0, 0, half]], axis=1), 2 * finger + k))
        for prism, mark in solids:
            walls = [np.concatenate([prism[i - 1], prism[i][::-1]]) for i in range(len(prism))]
            for face in (prism[:, 0], prism[:, 1], *walls):
                polygons.append((face, prism.mean((0, 1))))
                side_of.append(side)
                mark_of.append(mark)
    normals = []
    for face, middle in polygons:
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        normals.append(normal * np.sign(normal @ (face[0] - middle)) / np.linalg.norm(normal))
    return _Faces(
        np.concatenate([face for face, _ in polygons]),
        np.cumsum([len(face) for face, _ in polygons]),
        np.array(normals),
        np.array(side_of),
        np.array(mark_of),
    )


def draw_marks(
    shape: Instrument, tip_length_m: float, lens: Intrinsics, T_eye_tip: SE3, jaw_rad: float, fine: float
) -> list[NDArray[np.float64]] | None:
    """Return u, v (n, 2) of each mark's visible pixels as an eye sees a gripper, or None if it cannot be before it.

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
