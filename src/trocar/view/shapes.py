"""Shapes as triangles: all that is drawn is a tube of some kind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel
from trocar.sutures import Needle

SHAFT_RADIUS_M = 0.0042  # 8 mm instruments
SHAFT_SHOWN_M = 0.26
LINK_RADIUS_M = 0.0030
JAW_LENGTH_M = 0.0102  # wrist yaw axis to the jaws' tip (facts of the PSM: 10.2 mm)
JAW_WIDTH_M = 0.0022


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        vertices_m: (v, 3).
        faces: (f, 3) indices, counterclockwise as seen from outside.
    """

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.uint32]


def tube(points_m: ArrayLike, radii_m: ArrayLike, sides: int = 24) -> Mesh:
    """Return a closed tube along a path; with radii that change it is a cone or a disc.

    Args:
        points_m: (k, 3) its middle line; neighbours may coincide where the radius leaps.
        radii_m: (k,) or one for all.
        sides: corners of its cross-section.
    """
    points = np.asarray(points_m, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radii_m, dtype=np.float64), (len(points),))
    along = _directions(points)
    across = _carried(along)
    angle = np.arange(sides) * (2 * math.pi / sides)
    third = np.cross(along, across)
    circle = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * third[:, None]
    rings = points[:, None] + radii[:, None, None] * circle
    start, end = rings[0], rings[-1]  # once more: caps have edges
    vertices = np.concatenate([rings.reshape(-1, 3), start, points[:1], end, points[-1:]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for k in range(len(points) - 1):
        a, b, c, d = k * sides + i, k * sides + j, (k + 1) * sides + i, (k + 1) * sides + j
        faces += [np.stack([a, b, d], -1), np.stack([a, d, c], -1)]
    first = len(points) * sides
    last = first + sides + 1
    faces += [np.stack([first + j, first + i, np.full(sides, first + sides)], -1)]
    faces += [np.stack([last + i, last + j, np.full(sides, last + sides)], -1)]
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.uint32))


def shaft(arm: ArmModel) -> Mesh:
    """Return the instrument's shaft in frame 4: from the wrist back towards where the instrument comes from."""
    back = np.array([0.0, 0.0, arm.wrist_sign])
    return tube([0 * back, SHAFT_SHOWN_M * back], SHAFT_RADIUS_M)


def wrist_link(arm: ArmModel) -> Mesh:
    """Return the piece between wrist pitch and yaw in frame 5."""
    return tube([[0.0, 0.0, 0.0], [arm.wrist_length_m, 0.0, 0.0]], LINK_RADIUS_M)


def finger() -> Mesh:
    """Return one finger in a frame on the jaw axis, whose -z it points along; it closes against the plane x = 0."""
    z = np.array([0.0, -0.35, -1.0]) * JAW_LENGTH_M
    width, depth = JAW_WIDTH_M * np.array([1.2, 1.0, 0.5]), np.array([1.1, 0.9, 0.35]) * JAW_WIDTH_M
    corners = np.array([[0, -0.5], [1, -0.5], [1, 0.5], [0, 0.5]])
    vertices = np.array([[depth[k] * x, width[k] * y, z[k]] for k in range(3) for x, y in corners], dtype=np.float32)
    faces = [[0, 1, 2], [0, 2, 3], [8, 10, 9], [8, 11, 10]]
    for k in (0, 4):
        for i in range(4):
            a, b = k + i, k + (i + 1) % 4
            faces += [[a, a + 4, b + 4], [a, b + 4, b]]
    return Mesh(vertices, np.array(faces, dtype=np.uint32))


def needle_arc_m(needle: Needle, corners: int = 49) -> NDArray[np.float64]:
    """Return the needle's middle line (k, 3) in its frame, from tip to tail."""
    angle = -np.linspace(0.0, needle.arc_rad, corners)
    return needle.radius_m * np.stack([np.sin(angle), -np.cos(angle), 0 * angle], -1)


def wire(needle: Needle) -> Mesh:
    """Return the needle in its own frame; its tip is pointed."""
    line = needle_arc_m(needle)
    radii = np.full(len(line), needle.wire_m / 2)
    radii[:3] *= [0.05, 0.45, 0.85]
    return tube(line, radii, sides=12)


def _directions(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit directions (k, 3) of a path; where neighbours coincide, those of the path around."""
    steps = np.diff(points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    good = np.flatnonzero(length > 0)
    units = (steps / np.where(length > 0, length, 1.0)[:, None])[good[np.searchsorted(good[:-1], range(len(steps)))]]
    mean = np.concatenate([units[:1], units[:-1] + units[1:], units[-1:]])
    return mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _carried(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors (k, 3) across a path that turn about it as little as can be."""
    across = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    found = []
    for direction in along:
        across = across - direction * (across @ direction)
        across = across / np.linalg.norm(across)
        found.append(across)
    return np.array(found)
