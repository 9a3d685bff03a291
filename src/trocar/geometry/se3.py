"""Rigid transforms in three dimensions, batched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite
from trocar.geometry.so3 import RIGID, SO3, exp_coefficients, picked, require_rotation, skew

LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class SE3:
    """Pose(s): ``T_a_b`` is the pose of frame b in frame a, and ``T_a_c = T_a_b @ T_b_c``; metres.

    Attributes:
        matrix: (..., 4, 4) homogeneous; leading axes are the batch.

    Raises:
        TrocarError: a matrix is not a rigid transform: of another shape, not finite, or its first three rows and
            columns not a rotation.

    Example:
        >>> from math import pi
        >>> from trocar.geometry import SE3, SO3
        >>> T_world_base = SE3.from_parts(SO3.axis("z", pi / 2), (0.1, 0.0, 0.0))
        >>> T_base_tip = SE3.from_parts(translation_m=(0.2, 0.0, 0.0))
        >>> (T_world_base @ T_base_tip).translation_m.round(3).tolist()
        [0.1, 0.2, 0.0]
        >>> T_world_base.inverse().apply([0.1, 0.2, 0.0]).round(3).tolist()
        [0.2, 0.0, 0.0]
    """

    matrix: Array

    def __post_init__(self) -> None:
        matrix = finite("a pose", self.matrix, ..., 4, 4)
        require_rotation("the rotation of a pose", matrix[..., :3, :3])
        if np.abs(matrix[..., 3, :] - LAST_ROW).max(initial=0.0) > RIGID:
            remedy = "give T[:3, :3] a rotation, T[:3, 3] metres"
            raise InvalidInput("the last row", "of a pose is not 0, 0, 0, 1", remedy)
        object.__setattr__(self, "matrix", matrix)

    @staticmethod
    def unchecked(matrix: Array) -> SE3:
        """Return the pose(s) of matrices (..., 4, 4) that are known to be valid, such as computed ones."""
        made = object.__new__(SE3)
        object.__setattr__(made, "matrix", matrix)
        return made

    @staticmethod
    def of(pose: SE3 | ArrayLike) -> SE3:
        """Return a pose as it is, or the pose(s) of matrices (..., 4, 4), checked."""
        return pose if isinstance(pose, SE3) else SE3(pose)  # type: ignore[arg-type]

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> SE3:
        """Return the identity, repeated over ``batch``."""
        return SE3.unchecked(np.broadcast_to(np.eye(4), (*batch, 4, 4)))

    @staticmethod
    def from_parts(rotation: SO3 | None = None, translation_m: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """Return the pose with this rotation (default: identity) and translation (..., 3); batches broadcast."""
        R = (rotation or SO3.identity()).matrix
        p = finite("a translation", translation_m, ..., 3)
        matrix = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
        matrix[..., :3, :3] = R
        matrix[..., :3, 3] = p
        matrix[..., 3, 3] = 1.0
        return SE3.unchecked(matrix)

    @staticmethod
    def exp(twist: ArrayLike) -> SE3:
        """Return the pose reached in unit time by the twist(s) (..., 6) = (translation m, rotation rad)."""
        xi = finite("a twist", twist, ..., 6)
        v, w = xi[..., :3], xi[..., 3:]
        return SE3.from_parts(SO3.exp(w), np.einsum("...ij,...j->...i", _left_jacobian(w), v))

    def log(self) -> Array:
        """Return the twist(s) (..., 6) = (translation m, rotation rad) such that ``SE3.exp(T.log()) = T``."""
        w = self.rotation.log()
        v = np.linalg.solve(_left_jacobian(w), self.translation_m[..., None])[..., 0]
        return np.concatenate([v, w], -1, dtype=np.float64)

    @property
    def rotation(self) -> SO3:
        """Return the rotation part."""
        return SO3.unchecked(self.matrix[..., :3, :3])

    @property
    def translation_m(self) -> Array:
        """Return the translation (..., 3): the origin of frame b in frame a."""
        return self.matrix[..., :3, 3]

    def inverse(self) -> SE3:
        """Return ``T_b_a``."""
        R_inverse = np.swapaxes(self.matrix[..., :3, :3], -1, -2)
        matrix = np.zeros(self.matrix.shape)
        matrix[..., :3, :3] = R_inverse
        matrix[..., :3, 3] = -np.einsum("...ij,...j->...i", R_inverse, self.translation_m)
        matrix[..., 3, 3] = 1.0
        return SE3.unchecked(matrix)

    def apply(self, points_m: ArrayLike) -> Array:
        """Return points (..., 3), given in frame b, in frame a; the batch broadcasts."""
        return self.rotation.apply(points_m) + self.translation_m

    def adjoint(self) -> Array:
        """Return the adjoint (..., 6, 6), which takes twists in frame b to frame a."""
        R = self.rotation.matrix
        matrix = np.zeros((*R.shape[:-2], 6, 6))
        matrix[..., :3, :3] = R
        matrix[..., 3:, 3:] = R
        matrix[..., :3, 3:] = skew(self.translation_m) @ R
        return matrix

    def __matmul__(self, other: SE3) -> SE3:
        return SE3.unchecked(self.matrix @ other.matrix)

    def __getitem__(self, index: object) -> SE3:
        return SE3.unchecked(picked("poses", self.matrix, index))

    def __repr__(self) -> str:
        places = 1e3 * self.translation_m.reshape(-1, 3)
        if self.matrix.ndim == 2:
            return f"<SE3 {_shown(places[0])} mm, {self.rotation.about()}>"
        if not len(places):
            return f"<SE3 {self.matrix.shape[:-2]}: none>"
        return f"<SE3 {self.matrix.shape[:-2]}: within {_shown(places.min(0))} to {_shown(places.max(0))} mm>"


def one_pose(what: str, pose: SE3 | ArrayLike) -> SE3:
    """Return a single pose, also from a matrix (4, 4) (TrocarError: it is not a pose, or there are several)."""
    T = SE3.of(pose)
    if T.matrix.ndim != 2:
        raise InvalidInput(what, f"needs one pose (4, 4), got {T.matrix.shape}", "pick one with [k]")
    return T


def _left_jacobian(w: Array) -> Array:
    """Return the left Jacobian (..., 3, 3) of SO(3) at rotation vectors (..., 3): from twist to pose translation."""
    W = skew(w)
    _, b, c = exp_coefficients(np.sum(w * w, -1)[..., None, None])
    return np.eye(3) + b * W + c * (W @ W)


def _shown(place_mm: Array) -> str:
    """Return a position in words; zeros have no sign."""
    return f"({', '.join(f'{x:.1f}' for x in place_mm.round(1) + 0.0)})"
