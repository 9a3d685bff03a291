"""Direction and zoom of a picture's camera, chosen so that what matters fills the frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.perception.image import Intrinsics

WIDTH = 640
"""Width of a picture in pixels at scale 1."""
HEIGHTS = (0.56, 0.75)
"""Least and greatest height as a share of the width: flat objects get a flat picture, tall ones at most 4 to 3."""
FILLED = 0.94
"""Share of the frame to be filled; the rest is margin."""
NEAREST_M = 0.02
"""Points nearer to the camera, or behind it, count as this far away."""
AIMS = 6
"""Iterations: turning the camera to the middle of what it sees shifts that middle a little, less each time."""


@dataclass(frozen=True, eq=False)
class Framing:
    """A camera and its lens.

    Attributes:
        T_world_camera: OpenCV axes.
        lens: its pixels and focal lengths.
    """

    T_world_camera: SE3
    lens: Intrinsics


def framed(eye_m: NDArray[np.float64], points_m: NDArray[np.float64], scale: float = 1.0) -> Framing:
    """Return the level camera at a place in whose picture these points reach from edge to edge.

    Args:
        eye_m: (3,) where it stands, in the world.
        points_m: (n, 3) points to fill the frame, in the world; two or more, in front of the eye.
        scale: of the picture's pixels.
    """
    target = points_m.mean(axis=0)
    for _ in range(AIMS):
        T_world_camera = look_at(eye_m, target)
        low, high = _extent(T_world_camera, points_m)
        target = T_world_camera.apply(np.append((low + high) / 2, 1.0))
    T_world_camera = look_at(eye_m, target)
    low, high = _extent(T_world_camera, points_m)
    wide, tall = np.maximum(high - low, 1e-6)
    width = round(WIDTH * scale)
    height = round(width * float(np.clip(tall / wide, *HEIGHTS)))
    focal = FILLED * min(width / wide, height / tall)
    return Framing(T_world_camera, Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2))


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64]) -> SE3:
    """Return ``T_world_camera`` (OpenCV axes) of a level camera at ``eye_m`` that looks at ``target_m``."""
    z = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3(np.column_stack([x, np.cross(z, x), z])), eye_m)


def _extent(T_world_camera: SE3, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (2,), (2,) of what the points cover at a distance of 1 from the camera."""
    seen = T_world_camera.inverse().apply(points_m)
    flat = seen[:, :2] / np.maximum(seen[:, 2:], NEAREST_M)
    return flat.min(axis=0), flat.max(axis=0)
