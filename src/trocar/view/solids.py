"""Solids of a replay as meshes on their bodies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from trocar.errors import InvalidInput
from trocar.replay import SHAPES, Solid
from trocar.view.mesh import Mesh, box, creased, hull, joined, tube

Rgba = tuple[float, float, float, float]

SIDES = 24  # of round solids
RINGS = 7  # of half a sphere


@dataclass(frozen=True, eq=False)
class Part:
    """All solids of one colour on one body, drawn together.

    Attributes:
        mesh: in the body's frame.
        rgba: colour in [0, 1], sRGB.
    """

    mesh: Mesh
    rgba: Rgba


def body_parts(solids: Iterable[Solid]) -> dict[str, list[Part]]:
    """Return the meshes of each body that has solids, with colours in order of first occurrence."""
    meshes: dict[str, dict[Rgba, list[Mesh]]] = {}
    for solid in solids:
        on_body = solid_mesh(solid).moved(solid.T_body_solid)
        meshes.setdefault(solid.body, {}).setdefault(solid.rgba, []).append(on_body)
    return {body: [Part(creased(joined(some)), rgba) for rgba, some in by.items()] for body, by in meshes.items()}


def solid_mesh(solid: Solid) -> Mesh:
    """Return a solid in its own frame.

    Raises:
        TrocarError: an unknown shape, sizes that are not positive or of the wrong number, a flat hull.
    """
    if solid.shape not in SHAPES:
        raise InvalidInput(
            f"a solid on body '{solid.body}'", f"has shape '{solid.shape}'", f"choose from {', '.join(SHAPES)}"
        )
    if solid.shape == "hull":
        return hull(solid.vertices_m)
    count, make = SIZED[solid.shape]
    if len(solid.size_m) != count or not all(size > 0 for size in solid.size_m):
        raise InvalidInput(
            f"a {solid.shape} on body '{solid.body}'", f"has size {solid.size_m} m", f"give {count} numbers above 0"
        )
    return make(*solid.size_m)


def sphere(radius_m: float) -> Mesh:
    """Return a sphere about the origin."""
    return capsule(radius_m, 0.0)


def capsule(radius_m: float, half_m: float) -> Mesh:
    """Return a capsule along z; ``half_m`` is half the length between the middles of its round ends."""
    angle = np.linspace(0.0, math.pi / 2, RINGS + 1)
    radii = radius_m * np.cos(angle)
    radii[-1] = 0.0
    z = half_m + radius_m * np.sin(angle)
    if half_m == 0.0:  # one equator
        return _turned(np.concatenate([-z[:0:-1], z]), np.concatenate([radii[:0:-1], radii]))
    return _turned(np.concatenate([-z[::-1], z]), np.concatenate([radii[::-1], radii]))


def cylinder(radius_m: float, half_m: float) -> Mesh:
    """Return a cylinder along z, ``half_m`` to each side of the origin."""
    return _turned(np.array([-half_m, half_m]), np.array([radius_m, radius_m]))


def _turned(z_m: np.ndarray, radii_m: np.ndarray) -> Mesh:
    """Return the solid of revolution of a profile (k,) (k,) about z."""
    return tube(np.column_stack([0 * z_m, 0 * z_m, z_m]), radii_m, SIDES)


SIZED: Mapping[str, tuple[int, Callable[..., Mesh]]] = {
    "box": (3, lambda *half_m: box(half_m)),
    "sphere": (1, sphere),
    "capsule": (2, capsule),
    "cylinder": (2, cylinder),
}
"""The number of sizes of each shape, and the function that makes it."""
