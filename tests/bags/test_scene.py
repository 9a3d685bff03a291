"""Solids as markers: their sizes, places and surfaces."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.bags.scene import CUBE, CYLINDER, SPHERE, TRIANGLES, markers
from trocar.geometry import SE3, SO3
from trocar.replay import Solid

T = SE3.from_parts(SO3.axis("y", 0.3), [0.1, 0.2, 0.3])
RED = (1.0, 0.25, 0.0, 0.5)


def drawn(shape, *size, vertices=()):
    solid = Solid("body", shape, size, T, RED, np.array(vertices, dtype=float).reshape(-1, 3))
    return markers([solid], 5).markers


def place(marker):
    return [marker.pose.position.x, marker.pose.position.y, marker.pose.position.z]


@pytest.mark.parametrize(
    ("shape", "size", "kinds", "scales"),
    [
        ("box", (1.0, 2.0, 3.0), [CUBE], [(2.0, 4.0, 6.0)]),
        ("sphere", (0.5,), [SPHERE], [(1.0, 1.0, 1.0)]),
        ("cylinder", (0.5, 2.0), [CYLINDER], [(1.0, 1.0, 4.0)]),
        ("capsule", (0.5, 2.0), [CYLINDER, SPHERE, SPHERE], [(1.0, 1.0, 4.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)]),
    ],
)
def test_a_solid_has_its_whole_size(shape, size, kinds, scales):
    found = drawn(shape, *size)
    assert [marker.type for marker in found] == kinds
    assert [(m.scale.x, m.scale.y, m.scale.z) for m in found] == scales
    for marker in found:
        assert marker.frame_locked and marker.header.frame_id == "body" and marker.lifetime.sec == 0
        assert (marker.color.r, marker.color.g, marker.color.b, marker.color.a) == RED
        turn = marker.pose.orientation
        assert [turn.w, turn.x, turn.y, turn.z] == pytest.approx(T.rotation.as_quaternion())
    ends = [T.apply(np.array([0.0, 0.0, z])) for z in (0.0, -2.0, 2.0)][: len(found)]
    assert_allclose([place(marker) for marker in found], ends, atol=1e-12)


def test_a_hull_is_closed_and_faces_outwards():
    corners = 0.5 * (2 * np.indices((2, 2, 2)).reshape(3, 8).T - 1) + [3.0, 0.0, 0.0]
    (marker,) = drawn("hull", vertices=corners)
    assert marker.type == TRIANGLES
    points = np.array([[p.x, p.y, p.z] for p in marker.points]).reshape(-1, 3, 3) - [3.0, 0.0, 0.0]
    volume = np.einsum("ij,ij->i", points[:, 0], np.cross(points[:, 1], points[:, 2])).sum() / 6
    assert volume == pytest.approx(1.0)
