"""Rigid transforms in three dimensions, batched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.geometry.so3 import SO3, exp_coefficients, skew


@dataclass(frozen=True, eq=False)
class SE3:
    """Pose(s): ``T_a_b`` is the pose of frame b in frame a, and ``T_a_c = T_a_b @ T_b_c``; metres.

    Attributes:
        matrix: (..., 4, 4) homogeneous; leading axes are the batch.

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

    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=np.float64)
        if matrix.shape[-2:] != (4, 4):
            raise TrocarError(f"a pose needs shape (..., 4, 4), got {matrix.shape}")
        object.__setattr__(self, "matrix", matrix)

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> SE3:
        """Return the identity, repeated over ``batch``."""
        return SE3(np.broadcast_to(np.eye(4), (*batch, 4, 4)))

    @staticmethod
    def from_parts(rotation: SO3 | None = None, translation_m: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """Return the pose with this rotation (default: identity) and translation (..., 3); batches broadcast."""
        R = (rotation or SO3.identity()).matrix
        p = np.asarray(translation_m, dtype=np.float64)
        if p.shape[-1:] != (3,):
            raise TrocarError(f"a translation needs shape (..., 3), got {p.shape}")
        matrix = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
        matrix[..., :3, :3] = R
        matrix[..., :3, 3] = p
        matrix[..., 3, 3] = 1.0
        return SE3(matrix)

    @staticmethod
    def exp(twist: ArrayLike) -> SE3:
        """Return the pose reached in unit time by the twist(s) (..., 6) = (translation m, rotation rad)."""
        xi = np.asarray(twist, dtype=np.float64)
        if xi.shape[-1:] != (6,):
            raise TrocarError(f"a twist needs shape (..., 6), got {xi.shape}")
        v, w = xi[..., :3], xi[..., 3:]
        angle2 = np.sum(w * w, -1)[..., None, None]
        W = skew(w)
        _, b, c = exp_coefficients(angle2)
        V = np.eye(3) + b * W + c * (W @ W)
        return SE3.from_parts(SO3.exp(w), np.einsum("...ij,...j->...i", V, v))

    def log(self) -> NDArray[np.float64]:
        """Return the twist(s) (..., 6) = (translation m, rotation rad) such that ``SE3.exp(T.log()) = T``."""
        w = self.rotation.log()
        angle2 = np.sum(w * w, -1)[..., None, None]
        W = skew(w)
        _, b, c = exp_coefficients(angle2)
        V = np.eye(3) + b * W + c * (W @ W)
        v = np.linalg.solve(V, self.translation_m[..., None])[..., 0]
        return np.concatenate([v, w], -1, dtype=np.float64)

    @property
    def rotation(self) -> SO3:
        """Return the rotation part."""
        return SO3(self.matrix[..., :3, :3])

    @property
    def translation_m(self) -> NDArray[np.float64]:
        """Return the translation (..., 3): the origin of frame b in frame a."""
        return self.matrix[..., :3, 3]

    def inverse(self) -> SE3:
        """Return ``T_b_a``."""
        R_inverse = self.rotation.inverse()
        return SE3.from_parts(R_inverse, -R_inverse.apply(self.translation_m))

    def apply(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Return points (..., 3), given in frame b, in frame a; the batch broadcasts."""
        return self.rotation.apply(points_m) + self.translation_m

    def adjoint(self) -> NDArray[np.float64]:
        """Return the adjoint (..., 6, 6), which takes twists in frame b to frame a."""
        R = self.rotation.matrix
        matrix = np.zeros((*R.shape[:-2], 6, 6))
        matrix[..., :3, :3] = R
        matrix[..., 3:, 3:] = R
        matrix[..., :3, 3:] = skew(self.translation_m) @ R
        return matrix

    def __matmul__(self, other: SE3) -> SE3:
        return SE3(self.matrix @ other.matrix)

    def __getitem__(self, index: object) -> SE3:
        return SE3(self.matrix[index])  # type: ignore[index]
