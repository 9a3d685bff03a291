"""Meshes are closed, face outwards, have edges where they should, and keep their shape when moved or joined."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from triangles import edges_cancel, volume_m3

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.view.mesh import Mesh, box, creased, hull, joined, tube

SEEDS = st.integers(0, 2**32 - 1)


@given(seed=SEEDS)
def test_a_straight_tube_is_a_prism_whatever_its_direction(seed):
    start, end = np.random.default_rng(seed).normal(size=(2, 3))
    sides, radius = 12, 0.1
    mesh = tube([start, end], radius, sides)
    expected = sides / 2 * np.sin(2 * np.pi / sides) * radius**2 * np.linalg.norm(end - start)
    assert_allclose(volume_m3(mesh), expected, rtol=1e-3)


@pytest.mark.parametrize(
    "mesh",
    [
        tube([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 1, 2]], 0.1),
        tube([[0, 0, 0], [1, 2, 3], [1, 2, 3], [2, 4, 6]], [0.05, 0.05, 0.12, 0.0]),
    ],
)
def test_tubes_are_closed_and_face_outwards(mesh):
    assert mesh.faces.max() < len(mesh.vertices_m)
    assert edges_cancel(mesh)
    assert volume_m3(mesh) > 0


@given(seed=SEEDS, points=st.integers(4, 40))
def test_a_hull_is_closed_faces_outwards_and_holds_its_points(seed, points):
    corners = np.random.default_rng(seed).normal(size=(points, 3)) * [0.01, 0.02, 0.005]
    mesh = hull(corners)
    assert edges_cancel(mesh)
    assert_allclose(volume_m3(mesh), ConvexHull(corners).volume, rtol=1e-4)
    assert_allclose(mesh.vertices_m.min(0), corners.min(0), rtol=1e-5)
    assert_allclose(mesh.vertices_m.max(0), corners.max(0), rtol=1e-5)


@pytest.mark.parametrize("points", [np.eye(3), np.random.default_rng(0).normal(size=(9, 3)) * [1, 1, 0]])
def test_a_flat_hull_is_told(points):
    with pytest.raises(TrocarError, match=f"a hull of {len(points)} points spans no volume"):
        hull(points)


def test_a_box_has_its_sides_and_an_edge_between_any_two():
    mesh = box([0.1, 0.2, 0.3])
    assert_allclose(volume_m3(mesh), 8 * 0.1 * 0.2 * 0.3, rtol=1e-6)
    assert len(mesh.vertices_m) == 24  # each corner once for each of its three sides


def prism(sides):
    turn = np.arange(sides) * 2 * np.pi / sides
    flat = np.stack([np.cos(turn), np.sin(turn)], -1)
    return np.concatenate([np.column_stack([flat, np.full(sides, z)]) for z in (0.0, 1.0)])


@pytest.mark.parametrize(("sides", "copies"), [(6, 3), (24, 2)])
def test_a_prism_of_many_sides_is_shaded_as_round_but_for_its_ends(sides, copies):
    assert len(hull(prism(sides)).vertices_m) == 2 * sides * copies


def test_solids_that_lie_side_by_side_are_shaded_as_one():
    corners = prism(24)
    halves = [hull(corners[corners[:, 0] * side >= -1e-9]) for side in (1, -1)]
    both = creased(joined(halves))
    seam = both.vertices_m[(np.abs(both.vertices_m[:, 0]) < 1e-6) & (np.abs(both.vertices_m[:, 1] - 1) < 1e-6)]
    assert len(seam) == 2 * 4  # at each end: round side, end, and the two walls of the cut


@given(seed=SEEDS)
def test_moved_and_joined_meshes_keep_their_volumes(seed):
    rng = np.random.default_rng(seed)
    first, second = box(rng.uniform(0.1, 1.0, 3)), hull(rng.normal(size=(12, 3)))
    T = SE3.exp(rng.normal(size=6))
    assert_allclose(first.moved(T).vertices_m, T.apply(first.vertices_m), atol=1e-5)
    together = joined([first.moved(T), second])
    assert_allclose(volume_m3(together), volume_m3(first) + volume_m3(second), rtol=1e-3, atol=1e-4)
    assert together.faces.max() == len(together.vertices_m) - 1


def test_faces_without_area_are_dropped():
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], np.float32), np.array([[0, 1, 2], [0, 1, 3]]))
    assert len(creased(flat).faces) == 1
