"""The rigid transform between two sets of paired points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput, TrocarError
from trocar.geometry.arrays import Array, finite
from trocar.geometry.se3 import SE3
from trocar.geometry.so3 import SO3

COLLINEAR_RATIO = 1e-6  # points are collinear if their second principal extent is below this share of the first
RANSAC_DRAWS = 500
"""Random triples tried: with half of the pairs wrong, the chance that no triple is clean is below 1e-28."""


@dataclass(frozen=True, eq=False)
class RigidFit:
    """Result of ``fit_rigid``.

    Attributes:
        T_target_source: pose that takes source points to target points.
        rms_m: root mean square distance of the inliers after the fit.
        inliers: (n,) which pairs were used.
    """

    T_target_source: SE3
    rms_m: float
    inliers: NDArray[np.bool_]

    def __repr__(self) -> str:
        used = f"{self.inliers.sum()} of {len(self.inliers)} points"
        return f"<RigidFit of {used}: rms {1e3 * self.rms_m:.3g} mm, T_target_source {self.T_target_source!r}>"


def fit_rigid(
    source_m: ArrayLike,
    target_m: ArrayLike,
    *,
    inlier_distance_m: float | None = None,
    rng: np.random.Generator | None = None,
) -> RigidFit:
    """Return the least-squares rigid transform from source to target points (Arun 1987, Kabsch's sign).

    Args:
        source_m: (n, 3) points in the source frame.
        target_m: (n, 3) the same points in the target frame, in the same order.
        inlier_distance_m: leave out pairs that are farther apart than this under the best of many fits to random
            triples (RANSAC); default: use all pairs.
        rng: draws the triples; required with ``inlier_distance_m``.

    Raises:
        TrocarError: shapes differ, values are not finite, there are fewer than three pairs, or the points are
            collinear.

    Example:
        >>> import numpy as np
        >>> from trocar.geometry import SE3, SO3, fit_rigid
        >>> T_robot_camera = SE3.from_parts(SO3.axis("z", np.pi / 2), (0.1, 0.0, 0.3))
        >>> camera = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
        >>> fit = fit_rigid(camera, T_robot_camera.apply(camera))
        >>> bool(np.allclose(fit.T_target_source.matrix, T_robot_camera.matrix)), fit.rms_m < 1e-12
        (True, True)
    """
    source, target = finite("the source points", source_m, "n", 3), finite("the target points", target_m, "n", 3)
    if source.shape != target.shape:
        raise InvalidInput("paired points", f"need equal shapes, got source {source.shape} and target {target.shape}")
    inliers = np.ones(len(source), dtype=bool)
    if inlier_distance_m is not None:
        inliers = _consensus(source, target, inlier_distance_m, rng)
    T = _least_squares(source[inliers], target[inliers])
    square = np.sum((T.apply(source) - target) ** 2, -1)[inliers]
    return RigidFit(T, float(np.sqrt(square.mean())), inliers)


def _least_squares(source: Array, target: Array) -> SE3:
    if len(source) < 3:
        raise InvalidInput("a rigid fit", f"needs at least 3 pairs of points, got {len(source)}")
    center_s, center_t = source.mean(axis=0), target.mean(axis=0)
    from_s, from_t = source - center_s, target - center_t
    for points, what in ((from_s, "source"), (from_t, "target")):
        extent = np.linalg.svd(points, compute_uv=False)
        if extent[1] <= COLLINEAR_RATIO * extent[0]:
            problem = "lie on one line, so the rotation about it is unknown"
            raise InvalidInput(f"the {what} points", problem, "add points off it")
    u, _, vt = np.linalg.svd(from_t.T @ from_s)
    R = SO3.unchecked(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)
    return SE3.from_parts(R, center_t - R.apply(center_s))


def _consensus(source: Array, target: Array, distance_m: float, rng: np.random.Generator | None) -> NDArray[np.bool_]:
    """Return the largest set of pairs that agree with the fit to a random triple, refitted until it is stable."""
    if rng is None or not distance_m > 0:
        raise InvalidInput("leaving outliers out", f"needs rng and an inlier distance above 0 m, got {distance_m}")
    if len(source) < 3:
        raise InvalidInput("a rigid fit", f"needs at least 3 pairs of points, got {len(source)}")
    best = np.zeros(len(source), dtype=bool)
    for _ in range(RANSAC_DRAWS):
        triple = rng.choice(len(source), 3, replace=False)
        try:
            near = _near(_least_squares(source[triple], target[triple]), source, target, distance_m)
        except TrocarError:  # three points on a line
            continue
        if near.sum() > best.sum():
            best = near
    if best.sum() < 3:
        raise InvalidInput("no three pairs", f"agree within {distance_m} m", "check the pairing or raise the distance")
    for _ in range(10):
        again = _near(_least_squares(source[best], target[best]), source, target, distance_m)
        if np.array_equal(again, best) or again.sum() < best.sum():
            break
        best = again
    return best


def _near(T_target_source: SE3, source: Array, target: Array, distance_m: float) -> NDArray[np.bool_]:
    return np.linalg.norm(T_target_source.apply(source) - target, axis=-1) <= distance_m
