"""Solids as markers that RViz and Foxglove draw on the bodies' frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from trocar.bags.mcap_file import DURATION, kind, stamped
from trocar.geometry import SE3
from trocar.replay import Solid

Marker, Markers = kind("visualization_msgs", "Marker"), kind("visualization_msgs", "MarkerArray")
MeshFile, Texture = kind("visualization_msgs", "MeshFile"), kind("sensor_msgs", "CompressedImage")
Pose, Point, Quaternion = (kind("geometry_msgs", name) for name in ("Pose", "Point", "Quaternion"))
Vector, Color = kind("geometry_msgs", "Vector3"), kind("std_msgs", "ColorRGBA")
CUBE, SPHERE, CYLINDER, TRIANGLES = 1, 2, 3, 11


def markers(solids: Iterable[Solid], stamp_ns: int) -> Any:
    """Return a ``visualization_msgs/MarkerArray`` of solids, which stay visible and move with their bodies' frames."""
    made = (one for solid in solids for one in _shapes(solid))
    return Markers([_marker(number, stamp_ns, *one) for number, one in enumerate(made)])


def _shapes(solid: Solid) -> Iterator[tuple[Solid, int, SE3, tuple[float, ...], NDArray[np.float64]]]:
    """Yield a solid's markers: the solid, type, pose, size (x, y, z), corners of triangles (3 n, 3)."""
    none, T = np.zeros((0, 3)), solid.T_body_solid
    if solid.shape == "box":
        yield solid, CUBE, T, tuple(2 * half for half in solid.size_m), none
    elif solid.shape == "hull":
        yield solid, TRIANGLES, T, (1.0, 1.0, 1.0), _triangles(solid.vertices_m)
    else:
        radius, half = (*solid.size_m, 0.0)[:2]
        ball = (2 * radius,) * 3
        if half:
            yield solid, CYLINDER, T, (2 * radius, 2 * radius, 2 * half), none
        if solid.shape == "sphere":
            yield solid, SPHERE, T, ball, none
        elif solid.shape == "capsule":
            for end in (-half, half):
                yield solid, SPHERE, T @ SE3.from_parts(translation_m=[0.0, 0.0, end]), ball, none


def _triangles(vertices_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (3 n, 3) of a convex hull's triangles, counterclockwise as seen from outside."""
    found = ConvexHull(vertices_m)
    corners = vertices_m[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, found.equations[:, :3]) < 0
    corners[inward] = corners[inward][:, ::-1]
    return corners.reshape(-1, 3)


def _marker(
    number: int,
    stamp_ns: int,
    solid: Solid,
    shape: int,
    T_body_shape: SE3,
    size_m: tuple[float, ...],
    corners_m: NDArray[np.float64],
) -> Any:
    w, x, y, z = T_body_shape.rotation.as_quaternion()
    pose = Pose(Point(*T_body_shape.translation_m), Quaternion(x, y, z, w))
    points = [Point(*corner) for corner in corners_m]
    for_ever, mesh = DURATION(0, 0), MeshFile("", np.zeros(0, np.uint8))
    texture = Texture(stamped(0), "", np.zeros(0, np.uint8))
    header = stamped(stamp_ns, solid.body)
    return Marker(
        header=header,
        ns=solid.body,
        id=number,
        type=shape,
        action=0,
        pose=pose,
        scale=Vector(*size_m),
        color=Color(*solid.rgba),
        lifetime=for_ever,
        frame_locked=True,
        points=points,
        colors=[],
        texture_resource="",
        texture=texture,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=mesh,
        mesh_use_embedded_materials=False,
    )
