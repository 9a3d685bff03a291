"""Rotations in three dimensions, batched."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, direction, finite

RIGID = 1e-6  # tolerance for the columns' lengths and right angles: rounding, even in float32
SMALL_ANGLE_RAD = 1e-4
"""Below this angle the closed forms divide by almost 0; series to order four are exact to 1e-17 there."""


def skew(v: ArrayLike) -> Array:
    """Return the matrix ``[v]x`` such that ``[v]x w = v x w``; (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=np.float64)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -z, y
    matrix[..., 1, 0], matrix[..., 1, 2] = z, -x
    matrix[..., 2, 0], matrix[..., 2, 1] = -y, x
    return matrix


MAX_TURN_RAD = 1e9
"""Largest component of a rotation vector; beyond it, a float resolves the angle within a turn too coarsely."""


@dataclass(frozen=True, eq=False)
class SO3:
    """Rotation(s) held as matrices: ``R_a_b`` takes coordinates in b to coordinates in a.

    Attributes:
        matrix: (..., 3, 3) orthonormal with determinant +1; leading axes are the batch.

    Raises:
        TrocarError: a matrix is not a rotation: of another shape, not finite, not orthonormal, or a reflection.
    """

    matrix: Array

    def __post_init__(self) -> None:
        matrix = finite("a rotation", self.matrix, ..., 3, 3)
        require_rotation("a rotation", matrix)
        object.__setattr__(self, "matrix", matrix)

    @staticmethod
    def unchecked(matrix: Array) -> SO3:
        """Return the rotation(s) of matrices (..., 3, 3) that are known to be valid, such as computed ones."""
        made = object.__new__(SO3)
        object.__setattr__(made, "matrix", matrix)
        return made

    @staticmethod
    def nearest(matrix: ArrayLike) -> SO3:
        """Return the rotation(s) nearest to matrices (..., 3, 3), such as rotations that were rounded in a file.

        Raises TrocarError: a matrix has no nearest rotation: its columns do not span space, or it is a reflection.
        """
        given = finite("a matrix", matrix, ..., 3, 3)
        u, sizes, vt = np.linalg.svd(given)
        if np.any(np.linalg.det(given) <= 0) or np.any(sizes[..., -1] <= RIGID * sizes[..., 0]):
            raise InvalidInput("a matrix whose determinant", "is not above 0 is near no rotation", "check its columns")
        return SO3.unchecked(u @ vt)

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> SO3:
        """Return the identity, repeated over ``batch``."""
        return SO3.unchecked(np.broadcast_to(np.eye(3), (*batch, 3, 3)))

    @staticmethod
    def exp(rotvec_rad: ArrayLike) -> SO3:
        """Return the rotation about the axis ``rotvec_rad`` (..., 3) by its length (Rodrigues' formula)."""
        w = finite("a rotation vector", rotvec_rad, ..., 3)
        if w.size and np.abs(w).max() > MAX_TURN_RAD:
            problem = f"has a component of {np.abs(w).max():g} rad"
            raise InvalidInput("a rotation vector", problem, f"give at most {MAX_TURN_RAD:g} rad")
        angle2 = np.sum(w * w, -1)[..., None, None]
        W = skew(w)
        a, b, _ = exp_coefficients(angle2)
        return SO3.unchecked(np.eye(3) + a * W + b * (W @ W))

    @staticmethod
    def axis(axis: str, angle_rad: ArrayLike) -> SO3:
        """Return the rotation about the coordinate axis ``'x'``, ``'y'`` or ``'z'`` by ``angle_rad`` (...,)."""
        if axis not in ("x", "y", "z"):
            raise InvalidInput(f"axis {axis!r}", "is not one of 'x', 'y', 'z'")
        angle = finite(f"an angle about {axis}", angle_rad, ...)
        rotvec = np.zeros((*angle.shape, 3))
        rotvec[..., "xyz".index(axis)] = angle
        return SO3.exp(rotvec)

    @staticmethod
    def between(start: ArrayLike, end: ArrayLike) -> SO3:
        """Return the smallest rotation that takes one direction (3,) to another; for opposite ones, any half turn.

        Raises TrocarError: one of them has no direction.
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
        q = finite("a quaternion", wxyz, ..., 4)
        norm = np.linalg.norm(q, axis=-1, keepdims=True)
        if not np.all(norm > 0):
            raise InvalidInput("a quaternion", "of four zeros turns nowhere", "give one with a length above 0")
        q = q / norm
        w, v = q[..., :1, None], q[..., 1:]
        V = skew(v)
        return SO3.unchecked(np.eye(3) + 2 * w * V + 2 * V @ V)

    def as_quaternion(self) -> Array:
        """Return the quaternion(s) wxyz (..., 4) with w >= 0 (Shepperd's method)."""
        # Each row is the quaternion times one of its own elements; normalising the row of the largest element never
        # divides by a small number.
        m = self.matrix
        if m.ndim == 2:
            return _quaternion(m)
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

    def log(self) -> Array:
        """Return the rotation vector(s) (..., 3) in rad with length at most pi."""
        q = self.as_quaternion()
        w, v = q[..., :1], q[..., 1:]
        s = np.linalg.norm(v, axis=-1, keepdims=True)
        safe = np.where(s > 0, s, 1.0)
        return v * np.where(s > SMALL_ANGLE_RAD, 2 * np.arctan2(s, w) / safe, 2 / w - 2 * s * s / (3 * w**3))

    def inverse(self) -> SO3:
        """Return ``R_b_a``."""
        return SO3.unchecked(np.swapaxes(self.matrix, -1, -2))

    def apply(self, points: ArrayLike) -> Array:
        """Rotate points (..., 3); the batch broadcasts against their leading axes."""
        return np.einsum("...ij,...j->...i", self.matrix, np.asarray(points, dtype=np.float64))

    def angle(self) -> Array:
        """Return the angle of rotation (...,) in [0, pi] rad."""
        return np.linalg.norm(self.log(), axis=-1)

    def __matmul__(self, other: SO3) -> SO3:
        return SO3.unchecked(self.matrix @ other.matrix)

    def __getitem__(self, index: object) -> SO3:
        return SO3.unchecked(picked("rotations", self.matrix, index))

    def __repr__(self) -> str:
        if self.matrix.ndim == 2:
            return f"<SO3 {self.about()}>"
        degrees = np.degrees(self.angle())
        turned = f"turned by up to {degrees.max():.1f} deg" if degrees.size else "none"
        return f"<SO3 {self.matrix.shape[:-2]}: {turned}>"

    def about(self) -> str:
        """Return one rotation in words: angle and axis, such as ``90.0 deg about (0.00, 0.00, 1.00)``."""
        rotvec = self.log()
        angle = float(np.linalg.norm(rotvec))
        if math.degrees(angle) < 0.05:
            return "not turned"
        return f"{math.degrees(angle):.1f} deg about ({', '.join(f'{x:.2f}' for x in rotvec / angle)})"


def require_rotation(what: str, matrix: Array) -> None:
    """Raise TrocarError unless all of finite matrices (..., 3, 3) are rotations, to :data:`RIGID`."""
    with np.errstate(over="ignore", invalid="ignore"):  # squares of huge numbers
        off = np.abs(np.swapaxes(matrix, -1, -2) @ matrix - np.eye(3))
    off = np.nan_to_num(off, nan=np.inf, posinf=np.inf).max((-2, -1))
    if np.any(off > RIGID):
        far = f"but these are off by {off.max():.2g}{_which(off > RIGID)}"
        problem = f"needs columns of length 1 at right angles to each other, {far}"
        raise InvalidInput(what, problem, "repair rounding with SO3.nearest(R), and remove any scale")
    mirrored = np.linalg.det(matrix) < 0
    if np.any(mirrored):
        problem = f"has determinant -1{_which(mirrored)}: it is a reflection"
        raise InvalidInput(what, problem, "one axis has the wrong sign, or two are swapped")


def steady(wxyz: Array) -> Array:
    """Return quaternions (n, 4) of the same rotations, with signs chosen so that they change continuously."""
    jumps = (wxyz[1:] * wxyz[:-1]).sum(axis=1) < 0
    return wxyz * np.cumprod(np.append(1.0, np.where(jumps, -1.0, 1.0)))[:, None]


def _which(wrong: NDArray[np.bool_]) -> str:
    """Return the index of the first wrong item of a batch, in words; empty if there is only one item."""
    return f", first at {np.argwhere(wrong)[0].tolist()}" if wrong.ndim else ""


def picked(what: str, matrix: Array, index: Any) -> Array:
    """Return some matrices of a batch (..., n, n) (TrocarError: the index cuts into rows or columns)."""
    batch = matrix.shape[:-2]
    chosen = matrix[index]
    if chosen.shape[-2:] != matrix.shape[-2:]:
        remedy = f"a batch of shape {batch} has {len(batch)} axes"
        raise InvalidInput(f"index {index!r:.60}", f"cuts {what} apart", remedy)
    return chosen


def exp_coefficients(angle2: Array) -> tuple[NDArray, NDArray, NDArray]:
    """Return sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 as functions of t^2, accurate near 0 too."""
    small = angle2 < SMALL_ANGLE_RAD**2
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    half = np.sin(t / 2)
    a = np.where(small, 1 - angle2 / 6 + angle2**2 / 120, np.sin(t) / t)
    b = np.where(small, 0.5 - angle2 / 24 + angle2**2 / 720, 2 * half * half / t2)
    c = np.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (t - np.sin(t)) / (t2 * t))
    return a, b, c


def _quaternion(matrix: Array) -> Array:
    """Return ``as_quaternion`` of one rotation (3, 3), ten times faster than the batched code."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix.tolist()
    trace = xx + yy + zz
    squares = 1 + trace, 1 + (2 * xx - trace), 1 + (2 * yy - trace), 1 + (2 * zz - trace)
    w, x, y, z = squares
    a, b, c = zy - yz, xz - zx, yx - xy
    d, e, f = yx + xy, xz + zx, zy + yz
    row = ((w, a, b, c), (a, x, d, e), (b, d, y, f), (c, e, f, z))[squares.index(max(squares))]
    p, q, r, s = row
    found = np.array(row) / math.sqrt(p * p + q * q + r * r + s * s)
    return -found if p < 0 else found
