"""Rotations in three dimensions, batched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.geometry.direction import direction

SMALL_ANGLE_RAD = 1e-4
"""Below this angle the closed forms divide by almost 0; series to order four are exact to 1e-17 there."""


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """Return the matrix ``[v]x`` such that ``[v]x w = v x w``; (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=np.float64)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


@dataclass(frozen=True, eq=False)
class SO3:
    """Rotation(s) held as matrices: ``R_a_b`` takes coordinates in b to coordinates in a.

    Attributes:
        matrix: (..., 3, 3) orthonormal with determinant +1; leading axes are the batch.
    """

    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=np.float64)
        if matrix.shape[-2:] != (3, 3):
            raise TrocarError(f"a rotation needs shape (..., 3, 3), got {matrix.shape}")
        object.__setattr__(self, "matrix", matrix)

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> SO3:
        """Return the identity, repeated over ``batch``."""
        return SO3(np.broadcast_to(np.eye(3), (*batch, 3, 3)))

    @staticmethod
    def exp(rotvec_rad: ArrayLike) -> SO3:
        """Return the rotation about the axis ``rotvec_rad`` (..., 3) by its length (Rodrigues' formula)."""
        w = np.asarray(rotvec_rad, dtype=np.float64)
        if w.shape[-1:] != (3,):
            raise TrocarError(f"a rotation vector needs shape (..., 3), got {w.shape}")
        angle2 = np.sum(w * w, -1)[..., None, None]
        W = skew(w)
        a, b, _ = exp_coefficients(angle2)
        return SO3(np.eye(3) + a * W + b * (W @ W))

    @staticmethod
    def axis(axis: str, angle_rad: ArrayLike) -> SO3:
        """Return the rotation about the coordinate axis ``'x'``, ``'y'`` or ``'z'`` by ``angle_rad`` (...,)."""
        if axis not in ("x", "y", "z"):
            raise TrocarError(f"axis {axis!r} is not one of 'x', 'y', 'z'")
        rotvec = np.zeros((*np.shape(angle_rad), 3))
        rotvec[..., "xyz".index(axis)] = angle_rad
        return SO3.exp(rotvec)

    @staticmethod
    def between(start: ArrayLike, end: ArrayLike) -> SO3:
        """Return the smallest rotation that takes one direction (3,) to another; of opposite ones any half turn.

        Raises:
            TrocarError: one of them has no direction.
        """
        a, b = direction(start, "the first direction"), direction(end, "the second direction")
        axis, cosine = np.cross(a, b), float(a @ b)
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            if cosine > 0.0:
                return SO3.identity()
            axis, sine = np.cross(a, np.eye(3)[np.abs(a).argmin()]), 0.0
            return SO3.exp(np.pi * axis / np.linalg.norm(axis))
        return SO3.exp(axis / sine * np.arctan2(sine, cosine))

    @staticmethod
    def from_quaternion(wxyz: ArrayLike) -> SO3:
        """Return the rotation of the quaternion(s) ``wxyz`` (..., 4), which need not be normalised."""
        q = np.asarray(wxyz, dtype=np.float64)
        norm = np.linalg.norm(q, axis=-1, keepdims=True)
        if q.shape[-1:] != (4,) or not np.all(norm > 0):
            raise TrocarError(f"a quaternion needs shape (..., 4) and a length above 0, got shape {q.shape}")
        q = q / norm
        w, v = q[..., :1, None], q[..., 1:]
        V = skew(v)
        return SO3(np.eye(3) + 2 * w * V + 2 * V @ V)

    def as_quaternion(self) -> NDArray[np.float64]:
        """Return the quaternion(s) wxyz (..., 4) with w >= 0 (Shepperd's method)."""
        # Each row is the quaternion times one of its own elements; normalising the row of the largest element never
        # divides by a small number.
        m = self.matrix
        trace = np.trace(m, axis1=-2, axis2=-1)
        diagonal = np.diagonal(m, axis1=-2, axis2=-1)
        four_square = 1 + np.concatenate([trace[..., None], 2 * diagonal - trace[..., None]], -1)
        w, x, y, z = np.moveaxis(four_square, -1, 0)
        a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
        d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
        rows = np.stack([np.stack(r, -1) for r in ((w, a, b, c), (a, x, d, e), (b, d, y, f), (c, e, f, z))], -2)
        largest = np.argmax(four_square, -1)[..., None, None]
        q = np.take_along_axis(rows, np.broadcast_to(largest, (*largest.shape[:-1], 4)), -2)[..., 0, :]
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
        return np.where(q[..., :1] < 0, -q, q)

    def log(self) -> NDArray[np.float64]:
        """Return the rotation vector(s) (..., 3) in rad with length at most pi."""
        q = self.as_quaternion()
        w, v = q[..., :1], q[..., 1:]
        s = np.linalg.norm(v, axis=-1, keepdims=True)
        safe = np.where(s > 0, s, 1.0)
        return v * np.where(s > SMALL_ANGLE_RAD, 2 * np.arctan2(s, w) / safe, 2 / w - 2 * s * s / (3 * w**3))

    def inverse(self) -> SO3:
        """Return ``R_b_a``."""
        return SO3(np.swapaxes(self.matrix, -1, -2))

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Rotate points (..., 3); the batch broadcasts against their leading axes."""
        return np.einsum("...ij,...j->...i", self.matrix, np.asarray(points, dtype=np.float64))

    def angle(self) -> NDArray[np.float64]:
        """Return the angle of rotation (...,) in [0, pi] rad."""
        return np.linalg.norm(self.log(), axis=-1)

    def __matmul__(self, other: SO3) -> SO3:
        return SO3(self.matrix @ other.matrix)

    def __getitem__(self, index: object) -> SO3:
        return SO3(self.matrix[index])  # type: ignore[index]


def exp_coefficients(angle2: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Return sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 as functions of t^2, accurate near 0 too."""
    small = angle2 < SMALL_ANGLE_RAD**2
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    half = np.sin(t / 2)
    a = np.where(small, 1 - angle2 / 6 + angle2**2 / 120, np.sin(t) / t)
    b = np.where(small, 0.5 - angle2 / 24 + angle2**2 / 720, 2 * half * half / t2)
    c = np.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (t - np.sin(t)) / (t2 * t))
    return a, b, c
