"""Triangle meshes of solids and of the parts of an instrument."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from trocar.arms.solids import Part
from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3, TURN
from trocar.replay import SHAPES, Solid

CREASE_RAD = math.radians(30.0)  # faces that meet at a smaller angle are shaded as one rounded surface
WELD_M = 1e-6  # corners in the same cell of a grid this fine count as one corner
RINGS = 7  # of half a sphere
Rgba = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        vertices_m: (v, 3).
        faces: (f, 3) indices, counterclockwise as seen from outside.
    """

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.uint32]

    def moved(self, T_a_mesh: SE3) -> Mesh:
        """Return the mesh in frame a."""
        return Mesh(T_a_mesh.apply(self.vertices_m.astype(np.float64)).astype(np.float32), self.faces)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [mesh.faces + np.uint32(start) for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))


def box(half_m: ArrayLike) -> Mesh:
    """Return a box about the origin with these half lengths (3,)."""
    return hull((2 * np.indices((2, 2, 2)).reshape(3, 8).T - 1) * np.asarray(half_m, dtype=np.float64))


def hull(points_m: ArrayLike) -> Mesh:
    """Return the convex hull of points (n, 3).

    Raises:
        TrocarError: the points span no volume.
    """
    points = np.asarray(points_m, dtype=np.float64)
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        problem = f"of {len(points)} points spans no volume"
        raise InvalidInput("a hull", problem, "give at least four that do not lie in one plane") from None
    faces = found.simplices
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    return creased(Mesh(points.astype(np.float32), faces.astype(np.uint32)))


def creased(mesh: Mesh) -> Mesh:
    """Return a mesh whose faces share vertices where they meet at less than ``CREASE_RAD``, and nowhere else."""
    _, vertex = np.unique(np.round(mesh.vertices_m / WELD_M), axis=0, return_inverse=True)
    faces = vertex.ravel()[mesh.faces]
    real = (faces != np.roll(faces, 1, axis=1)).all(1)
    faces, corners = faces[real], mesh.faces[real]
    surface = _smooth_surfaces(faces, _normals(mesh.vertices_m[corners]))
    pairs = np.stack([np.repeat(surface, 3), faces.ravel()], -1)
    _, first, index = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    return Mesh(mesh.vertices_m[corners.ravel()[first]], index.reshape(-1, 3).astype(np.uint32))


def _normals(corners_m: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the unit normals (f, 3) of triangles (f, 3, 3)."""
    a, b, c = np.moveaxis(corners_m.astype(np.float64), 1, 0)
    normal = np.cross(b - a, c - a)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)


def _smooth_surfaces(faces: NDArray[np.intp], normals: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return for each face (f, 3), with its normal (f, 3), the index of the smooth surface that it belongs to."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    links = []
    for step in (1, 2, 3):  # two faces meet at an edge, or four if two solids are side by side
        same = (edges[step:] == edges[:-step]).all(1)
        a, b = owner[:-step][same], owner[step:][same]
        links.append(np.stack([a, b])[:, np.einsum("ij,ij->i", normals[a], normals[b]) > math.cos(CREASE_RAD)])
    a, b = np.concatenate(links, axis=1)
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))
    return connected_components(graph, directed=False)[1]


def tube(points_m: ArrayLike, radii_m: ArrayLike, sides: int = 24) -> Mesh:
    """Return a closed tube along a path (k, 3) with these radii (k,), or one radius for all points.

    Neighbouring points may coincide where the radius jumps. ``sides``: number of corners of the cross-section.
    """
    points = np.asarray(points_m, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radii_m, dtype=np.float64), (len(points),))
    along = _directions(points)
    across = _carried(along)
    angle = np.arange(sides) * (TURN / sides)
    third = np.cross(along, across)
    circle = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * third[:, None]
    rings = points[:, None] + radii[:, None, None] * circle
    start, end = rings[0], rings[-1]  # repeated, so that the caps have sharp edges
    vertices = np.concatenate([rings.reshape(-1, 3), start, points[:1], end, points[-1:]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for k in range(len(points) - 1):
        a, b, c, d = k * sides + i, k * sides + j, (k + 1) * sides + i, (k + 1) * sides + j
        faces += [np.stack([a, b, d], -1), np.stack([a, d, c], -1)]
    first = len(points) * sides
    last = first + sides + 1
    faces += [np.stack([first + j, first + i, np.full(sides, first + sides)], -1)]
    faces += [np.stack([last + i, last + j, np.full(sides, last + sides)], -1)]
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.uint32))


def _directions(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit directions (k, 3) of a path; where neighbours coincide, those of the path nearby."""
    steps = np.diff(points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    good = np.flatnonzero(length > 0)
    units = (steps / np.where(length > 0, length, 1.0)[:, None])[good[np.searchsorted(good[:-1], range(len(steps)))]]
    mean = np.concatenate([units[:1], units[:-1] + units[1:], units[-1:]])
    return mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _carried(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors (k, 3) across a path that turn about it as little as possible."""
    across = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    found = []
    for direction in along:
        across = across - direction * (across @ direction)
        across = across / np.linalg.norm(across)
        found.append(across)
    return np.array(found)


def part_mesh(part: Part) -> Mesh:
    """Return a part of an instrument in the frame of its link."""
    if part.shape == "box":
        return box(0.5 * np.array(part.size_m)).moved(SE3.from_parts(translation_m=part.at_m[0]))
    start, end = part.at_m
    along = SE3.from_parts(SO3.between([0.0, 0.0, 1.0], end - start), 0.5 * (start + end))
    make = _capsule if part.shape == "capsule" else _cylinder
    return make(part.size_m[0], 0.5 * float(np.linalg.norm(end - start))).moved(along)


def body_parts(solids: Iterable[Solid]) -> dict[str, dict[Rgba, Mesh]]:
    """Return, for each body that has solids, one mesh per colour ([0, 1], sRGB), in the body's frame."""
    meshes: dict[str, dict[Rgba, list[Mesh]]] = {}
    for solid in solids:
        on_body = solid_mesh(solid).moved(solid.T_body_solid)
        meshes.setdefault(solid.body, {}).setdefault(solid.rgba, []).append(on_body)
    return {body: {rgba: creased(joined(some)) for rgba, some in by.items()} for body, by in meshes.items()}


def solid_mesh(solid: Solid) -> Mesh:
    """Return a solid in its own frame.

    Raises:
        TrocarError: an unknown shape, sizes that are not positive or of the wrong number, a flat hull.
    """
    if solid.shape not in SHAPES:
        where = f"a solid on body '{solid.body}'"
        raise InvalidInput(where, f"has shape '{solid.shape}'", f"choose from {', '.join(SHAPES)}")
    if solid.shape == "hull":
        return hull(solid.vertices_m)
    count, make = SIZED[solid.shape]
    if len(solid.size_m) != count or not all(size > 0 for size in solid.size_m):
        where = f"a {solid.shape} on body '{solid.body}'"
        raise InvalidInput(where, f"has size {solid.size_m} m", f"give {count} numbers above 0")
    return make(*solid.size_m)


def _capsule(radius_m: float, half_m: float = 0.0) -> Mesh:
    """Return a capsule along z; ``half_m``: half the distance between the centres of its ends, 0 for a sphere."""
    angle = np.linspace(0.0, math.pi / 2, RINGS + 1)
    radii = radius_m * np.cos(angle)
    radii[-1] = 0.0
    z = half_m + radius_m * np.sin(angle)
    lower = slice(None, 0 if half_m == 0.0 else None, -1)  # a sphere has one equator
    z_m = np.concatenate([-z[lower], z])
    return tube(np.outer(z_m, [0.0, 0.0, 1.0]), np.concatenate([radii[lower], radii]))


def _cylinder(radius_m: float, half_m: float) -> Mesh:
    return tube([[0.0, 0.0, -half_m], [0.0, 0.0, half_m]], radius_m)


SIZED: Mapping[str, tuple[int, Callable[..., Mesh]]] = {
    "box": (3, lambda *half_m: box(half_m)),
    "sphere": (1, _capsule),
    "capsule": (2, _capsule),
    "cylinder": (2, _cylinder),
}
"""The number of sizes of each shape, and the function that makes it."""
