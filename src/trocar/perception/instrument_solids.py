"""Signed distances to the solids of an instrument that a camera sees: shaft, clevis, knuckle and both fingers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from trocar.arms import ArmModel, frames
from trocar.arms.instrument import CLEVIS_SHARE, KNUCKLE_SHARE, SLEEVE_M, SLEEVE_SHARE, Instrument
from trocar.geometry.arrays import Array

CARRIED = np.array([[0, 0, 0], [0, 0, 0], [1, 1, 0], [1, 1, 1], [1, 1, 1], [1, 1, 1]], dtype=np.float64)
"""(6, 3): 1 where q4 q5 q6 visibly move a solid. Rows: shaft, sleeve (both round), clevis, knuckle, two fingers."""
FRAMES = np.array([0, 0, 1, 2, 2, 2])  # index of the frame (4, 5 or 6) in which each solid is fixed


@dataclass(frozen=True)
class Cylinder:
    """A solid of revolution about z, closed at both ends."""

    radius_m: float
    lower_m: float
    upper_m: float

    def _out(self, p: Array) -> tuple[Array, Array]:
        middle, half = 0.5 * (self.lower_m + self.upper_m), 0.5 * (self.upper_m - self.lower_m)
        return np.hypot(p[:, 0], p[:, 1]) - self.radius_m, np.abs(p[:, 2] - middle) - half

    def distance_m(self, p: Array) -> Array:
        """Return the signed distances (n,) of points (n, 3)."""
        beside, beyond = self._out(p)
        inside = np.minimum(np.maximum(beside, beyond), 0.0)
        return inside + np.hypot(np.maximum(beside, 0.0), np.maximum(beyond, 0.0))

    def gradient(self, p: Array) -> Array:
        """Return the gradients (n, 3)."""
        beside, beyond = self._out(p)
        out = np.column_stack([np.maximum(beside, 0.0), np.maximum(beyond, 0.0)])
        flat = beyond > beside
        inside = (beside <= 0.0) & (beyond <= 0.0)
        out[inside] = np.column_stack([~flat, flat])[inside]
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        radial = p[:, :2] / np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-12)[:, None]
        axial = np.sign(p[:, 2] - 0.5 * (self.lower_m + self.upper_m))
        return np.column_stack([out[:, :1] * radial, out[:, 1] * axial])


@dataclass(frozen=True, eq=False)
class Capsule:
    """A rod from the frame's origin to an end (3,)."""

    end_m: Array
    radius_m: float

    def _away(self, p: Array) -> Array:
        along = np.clip(p @ self.end_m / (self.end_m @ self.end_m), 0.0, 1.0)
        return p - along[:, None] * self.end_m

    def distance_m(self, p: Array) -> Array:
        """Return the signed distances (n,) of points (n, 3)."""
        return np.linalg.norm(self._away(p), axis=1) - self.radius_m

    def gradient(self, p: Array) -> Array:
        """Return the gradients (n, 3)."""
        away = self._away(p)
        return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex solid given by outward normals (k, 3) and offsets (k,); distances near its edges are slightly small."""

    normals: Array
    offsets: Array

    def distance_m(self, p: Array) -> Array:
        """Return the signed distances (n,) of points (n, 3)."""
        return (p @ self.normals.T + self.offsets).max(axis=1)

    def gradient(self, p: Array) -> Array:
        """Return the gradients (n, 3)."""
        return self.normals[(p @ self.normals.T + self.offsets).argmax(axis=1)]


Solid = Cylinder | Capsule | Hull


@dataclass(frozen=True, eq=False)
class InstrumentSolids:
    """An instrument in one configuration."""

    R: Array  # (3, 3, 3) of frames 4, 5, 6 in the arm's base
    p: Array  # (3, 3) their origins, m
    solids: Sequence[Solid]  # shaft, sleeve, clevis, knuckle, left and right finger, in their frames

    @staticmethod
    def of(arm: ArmModel, q: Array, jaw_rad: float) -> InstrumentSolids:
        """Return the solids of an arm's instrument at joints (6,) and an opening between the fingers."""
        shape, pose, back = arm.instrument, frames(arm, q).matrix, float(arm.wrist_sign)
        R, p = pose[4:7, :3, :3], pose[4:7, :3, 3]
        half_m = 0.5 * KNUCKLE_SHARE * shape.finger_width_m
        link = R[1].T @ (p[2] - p[1])
        solids: list[Solid] = [
            Cylinder(shape.shaft_radius_m, *sorted((back * SLEEVE_M[1], back * shape.shaft_length_m))),
            Cylinder(SLEEVE_SHARE * shape.shaft_radius_m, *sorted((back * SLEEVE_M[0], back * SLEEVE_M[1]))),
            Capsule(CLEVIS_SHARE * link, shape.wrist_radius_m),
            Cylinder(shape.knuckle_radius_m, -half_m, half_m),
            *(_finger(shape, side, jaw_rad) for side in (1, -1)),
        ]
        return InstrumentSolids(R, p, solids)

    def distance_m(self, points_m: Array) -> Array:
        """Return the signed distances (n,) of points (n, 3) in the arm's base to the nearest solid."""
        return self._all(self._local(points_m)).min(axis=0)

    def slopes(self, points_m: Array) -> tuple[Array, Array]:
        """Return the distances (n,) of points (n, 3), and their derivatives (n, 6).

        The derivatives are by q4 q5 q6 (m/rad) and by a shift of the whole instrument in the base.
        """
        local = self._local(points_m)
        found = self._all(local)
        nearest = found.argmin(axis=0)
        by = np.empty((len(points_m), 6))
        for number, solid in enumerate(self.solids):
            rows = nearest == number
            frame = FRAMES[number]
            normal = solid.gradient(local[frame][rows]) @ self.R[frame].T
            arms = points_m[rows] - self.p[:, None]
            moves = np.cross(self.R[:, :, 2][:, None], arms)  # velocity of a point on the solid, by joint
            by[rows, :3] = -np.einsum("ni,kni->nk", normal, moves) * CARRIED[number]
            by[rows, 3:] = -normal
        return found.min(axis=0), by

    def _local(self, points_m: Array) -> list[Array]:
        return [(points_m - p) @ R for R, p in zip(self.R, self.p, strict=True)]

    def _all(self, local: Sequence[Array]) -> Array:
        return np.array([solid.distance_m(local[frame]) for solid, frame in zip(self.solids, FRAMES, strict=True)])


def _finger(shape: Instrument, side: int, jaw_rad: float) -> Hull:
    """Return one finger in frame 6, along whose y the jaws point."""
    angle = 0.5 * (np.pi + side * jaw_rad)
    c, s = np.cos(angle), np.sin(angle)
    normals, offsets = _planes(shape, side)
    return Hull(normals @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), offsets)


@lru_cache(maxsize=8)
def _planes(shape: Instrument, side: int) -> tuple[Array, Array]:
    """Return outward normals (k, 3) and offsets (k,) of a finger's faces in its joint's frame."""
    hull = np.unique(ConvexHull(shape.finger_m(side)).equations.round(9), axis=0)
    return hull[:, :3], hull[:, 3]
