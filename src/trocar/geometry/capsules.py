"""Distances between capsules in closed form; planning and the guard treat shafts, wrists and fingers as capsules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trocar.geometry.arrays import Array
from trocar.geometry.se3 import SE3

PARALLEL = 1e-12  # segments count as parallel if the squared sine of their angle is below this


@dataclass(frozen=True, eq=False)
class Capsules:
    """A set of capsules: segments with a radius.

    Attributes:
        ends_m: (..., k, 2, 3) both ends of each segment; they may coincide (a sphere).
        radii_m: (k,).
    """

    ends_m: Array
    radii_m: Array

    def moved(self, T: SE3) -> Capsules:
        """Return the capsules in frame a, given ``T`` (...,) = ``T_a_b`` and these capsules in frame b."""
        ends = self.ends_m.reshape(*self.ends_m.shape[:-3], -1, 3)
        R, t = T.matrix[..., :3, :3], T.matrix[..., :3, 3]
        moved = ends @ np.swapaxes(R, -1, -2) + t[..., None, :]
        return Capsules(moved.reshape(*moved.shape[:-2], -1, 2, 3), self.radii_m)


def capsule_distances_m(a: Capsules, b: Capsules) -> Array:
    """Return the distances (..., k, m) of all pairs of capsules of two sets; negative where they overlap."""
    p, q = a.ends_m[..., :, None, :, :], b.ends_m[..., None, :, :, :]
    between = segment_distances_m(p[..., 0, :], p[..., 1, :], q[..., 0, :], q[..., 1, :])
    return between - a.radii_m[:, None] - b.radii_m


def segment_distances_m(p0: ArrayLike, p1: ArrayLike, q0: ArrayLike, q1: ArrayLike) -> Array:
    """Return the least distance (...,) between the segments p0 p1 and q0 q1, each end (..., 3)."""
    return np.linalg.norm(nearest_m(p0, p1, q0, q1)[0], axis=-1)


def nearest_m(p0: ArrayLike, p1: ArrayLike, q0: ArrayLike, q1: ArrayLike) -> tuple[Array, Array, Array]:
    """Return the shortest vector (..., 3) from the segment q0 q1 to p0 p1, and where on both it ends (...,).

    Ericson, Real-Time Collision Detection, 5.1.9: the nearest points of the two lines, clamped to one segment after the
    other.

    Returns:
        The vector; the place of its end between p0 (0) and p1 (1); the place of its start between q0 (0) and q1 (1).
    """
    p0, p1, q0, q1 = (np.asarray(x, dtype=np.float64) for x in (p0, p1, q0, q1))
    u, v, w = p1 - p0, q1 - q0, p0 - q0
    uu, vv, uv, uw, vw = _dot(u, u), _dot(v, v), _dot(u, v), _dot(u, w), _dot(v, w)
    determinant = uu * vv - uv * uv
    crossing = determinant > PARALLEL * uu * vv
    s = np.where(crossing, (uv * vw - vv * uw) / np.where(crossing, determinant, 1.0), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((uv * s + vw) / np.where(vv > 0, vv, 1.0), 0.0, 1.0)
    s = np.clip((uv * t - uw) / np.where(uu > 0, uu, 1.0), 0.0, 1.0)
    return w + s[..., None] * u - t[..., None] * v, s, t


def cross(a: Array, b: Array) -> Array:
    """Return a x b over the last axis; NumPy's takes four times as long for a few rows."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0], out[..., 1], out[..., 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out


def _dot(x: Array, y: Array) -> Array:
    """Return x . y over the last axis; einsum takes half the time of a sum of products."""
    return np.einsum("...i,...i->...", x, y)
