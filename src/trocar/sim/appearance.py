"""The appearance of surfaces beyond a plain colour: grain of the material, and wet spots that mirror the lamp."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry.arrays import Array

GRAIN_M = (2.4e-3, 1.1e-3)
"""Correlation lengths of a surface's grain: two octaves, the second half as strong (assumed)."""
RIPPLE_M = 1.5e-3
RIPPLE = 0.35
"""Length and slope of ripples in the film of water on a wet surface (assumed)."""
SPOT_EXPONENT = 120.0
"""Specular exponent of a surface of shininess 1."""
LATTICE = np.array([73856093, 19349663, 83492791])
"""Factors that turn the three coordinates of a lattice point into its key."""
AT_ONCE = 8192
"""Number of points processed at a time; intermediate arrays then stay in the processor's cache."""


class Sight(NamedTuple):
    """Points (n, 3) on surfaces, outward normals (n, 3), eye (3,) and lamp (3,), all in the world's frame."""

    geom: NDArray[np.int32]  # (n,) ids, -1 for nothing
    points_m: Array
    normal: Array
    eye_m: Array
    lamp_m: Array
    lit: NDArray[np.bool_]  # (n,) whether the lamp reaches the point


class Appearance:
    """Grain and wet spots of geoms that have a material; they move with the body.

    MuJoCo's materials define their strength: ``roughness`` is twice the relative standard deviation of the albedo,
    ``specular`` the brightness of a spot where the film of water mirrors the lamp, ``shininess`` its sharpness.
    """

    def __init__(self, model: mujoco.MjModel):
        material = model.geom_matid
        with_material = material >= 0

        def of_geoms(values: NDArray) -> NDArray[np.float32]:
            """Return the value of each geom's material; then a 0, for rays that hit nothing (geom -1)."""
            found = np.where(with_material, values[material], 0.0) if len(values) else np.zeros(len(material))
            return np.append(np.maximum(found, 0.0), 0.0).astype(np.float32)

        qualities = model.mat_roughness, model.mat_specular, model.mat_shininess
        self._grain, self._wet, self._shininess = map(of_geoms, qualities)

    def apply(self, data: mujoco.MjData, color: NDArray[np.float32], sight: Sight) -> NDArray[np.float32]:
        """Return the colours (n, 3) in [0, 1] with grain and spots."""
        color = color.copy()
        grainy = np.flatnonzero(self._grain[sight.geom] > 0)
        if len(grainy):
            local, geom = _in_geom(data, sight, grainy)
            factor = 1.0 + self._grain[geom] * _grain(local, geom)
            color[grainy] *= np.clip(factor, 0.3, 1.9)[:, None]
        wet = np.flatnonzero((self._wet[sight.geom] > 0) & sight.lit)
        if len(wet):
            color[wet] += self._spots(data, sight, wet)[:, None]
        return np.clip(color, 0, 1)

    def _spots(self, data: mujoco.MjData, sight: Sight, wet: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the brightness (n,) of spots at these points, by Blinn-Phong reflection with rippled normals."""
        local, geom = _in_geom(data, sight, wet)
        ripple = np.stack([_noise(local / RIPPLE_M, geom * 3 + axis) for axis in range(3)], -1)
        normal = _unit(sight.normal[wet] + RIPPLE * ripple)
        half = _unit(_unit(sight.lamp_m - sight.points_m[wet]) + _unit(sight.eye_m - sight.points_m[wet]))
        along = np.maximum(np.einsum("ij,ij->i", normal, half), 0)
        return (self._wet[geom] * along ** (SPOT_EXPONENT * self._shininess[geom])).astype(np.float32)


def _in_geom(
    data: mujoco.MjData, sight: Sight, points: NDArray[np.intp]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return these points in the frames of their geoms, and the geoms."""
    geom = sight.geom[points]
    local = np.empty((len(points), 3), dtype=np.float32)
    for one in np.unique(geom):
        here = geom == one
        local[here] = (sight.points_m[points[here]] - data.geom_xpos[one]) @ data.geom_xmat[one].reshape(3, 3)
    return local, geom


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _grain(local_m: NDArray[np.float32], geom: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the grain (n,), of standard deviation .5, at points in the geoms' frames."""
    coarse, fine = (_noise(local_m / np.float32(length), geom * 7 + k) for k, length in enumerate(GRAIN_M))
    return np.asarray(coarse + 0.5 * fine, dtype=np.float32)


def _noise(at: NDArray, seed: NDArray) -> NDArray[np.float32]:
    """Return smooth noise (n,) of standard deviation .45: random values on a lattice, interpolated linearly."""
    at, seed = at.astype(np.float32), seed.astype(np.int64) * 2654435761
    noise = [_noise_of_few(at[k : k + AT_ONCE], seed[k : k + AT_ONCE]) for k in range(0, len(at), AT_ONCE)]
    return np.float32(2.9) * np.concatenate(noise)  # scaled; at the lattice points, the standard deviation is .84


def _noise_of_few(at: NDArray[np.float32], seed: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the unscaled noise (n,) at points (n, 3): trilinear interpolation between the corners of a cell."""
    cell = np.floor(at)
    part, corner = (at - cell).T, cell.T.astype(np.int64)
    shares = 1 - part, part
    keys = [(corner + step) * LATTICE[:, None] for step in (0, 1)]
    total = np.zeros(len(at), dtype=np.float32)
    for dx, dy, dz in product((0, 1), repeat=3):
        weight = shares[dx][0] * shares[dy][1] * shares[dz][2]
        total += weight * _value(keys[dx][0] ^ keys[dy][1] ^ keys[dz][2] ^ seed)
    return total


def _value(key: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a pseudo-random value in [-.5, .5) from a lattice point's key."""
    mixed = ((key ^ (key >> 13)) * 1274126177) & 0xFFFFFFFF
    mixed ^= mixed >> 16
    return (mixed & 0xFFFF).astype(np.float32) / np.float32(65536.0) - np.float32(0.5)
