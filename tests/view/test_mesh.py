"""Triangle meshes of solids and of the parts of an instrument."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from triangles import edges_cancel, volume_m3

from made_up_replay import made_up_replay
from trocar.arms import ARMS
from trocar.arms.solids import parts_of
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.replay import Solid
from trocar.view.mesh import Mesh, body_parts, box, creased, hull, joined, part_mesh, solid_mesh, tube

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


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_parts_of_an_instrument_are_closed_face_outwards_and_are_where_and_as_large_as_they_are(arm):
    for part in parts_of(arm):
        drawn = part_mesh(part)
        assert edges_cancel(drawn) and volume_m3(drawn) > 0
        points_m, start = drawn.vertices_m.astype(float), part.at_m[0]
        if part.shape == "box":
            assert_allclose([points_m.min(0), points_m.max(0)], start + np.outer([-0.5, 0.5], part.size_m), atol=1e-7)
            continue
        length = np.linalg.norm(part.at_m[1] - start)
        along = (part.at_m[1] - start) / length
        reach, cap = (points_m - start) @ along, part.size_m[0] * (part.shape == "capsule")
        assert_allclose([reach.min(), reach.max()], [-cap, length + cap], atol=1e-7)
        away = np.linalg.norm(points_m - start - reach[:, None] * along, axis=1)
        assert away.max() == pytest.approx(part.size_m[0], abs=1e-7)


RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.5)
LENGTH = st.floats(1e-4, 1.0)


NONE = np.zeros((0, 3))


def solid(shape, *size_m, vertices_m=NONE, rgba=RED, T=None):
    return Solid("body", shape, size_m, T or SE3.identity(), rgba, vertices_m)


@given(a=LENGTH, b=LENGTH, c=LENGTH)
def test_shapes_fill_their_box_and_are_closed(a, b, c):
    for shape, size_m, half in (
        ("box", (a, b, c), (a, b, c)),
        ("sphere", (a,), (a, a, a)),
        ("capsule", (a, b), (a, a, a + b)),
        ("cylinder", (a, b), (a, a, b)),
    ):
        mesh = solid_mesh(solid(shape, *size_m))
        assert_allclose(mesh.vertices_m.max(0), half, rtol=1e-5)
        assert_allclose(mesh.vertices_m.min(0), -np.array(half), rtol=1e-5)
        assert edges_cancel(mesh), shape


@given(radius=st.floats(0.1, 1.0), half=st.floats(0.1, 1.0))
def test_round_shapes_have_nearly_the_volumes_of_the_textbook(radius, half):
    disc, ball = np.pi * radius**2, 4 / 3 * np.pi * radius**3
    for shape, size_m, volume in (
        ("sphere", (radius,), ball),
        ("capsule", (radius, half), ball + disc * 2 * half),
        ("cylinder", (radius, half), disc * 2 * half),
    ):
        found = volume_m3(solid_mesh(solid(shape, *size_m)))
        assert 0.96 * volume < found <= volume, shape


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (solid("cone", 1.0), "has shape 'cone'; choose from box, sphere"),
        (solid("box", 1.0), r"a box on body 'body' has size \(1.0,\) m; give 3 numbers"),
        (solid("sphere", 0.0), "give 1 numbers above 0"),
        (solid("capsule", 0.1, float("nan")), "give 2 numbers above 0"),
        (solid("hull", vertices_m=np.zeros((5, 3))), "spans no volume"),
    ],
)
def test_what_is_no_solid_is_told(wrong, sentence):
    with pytest.raises(TrocarError, match=sentence):
        solid_mesh(wrong)


def test_solids_of_one_colour_on_one_body_are_drawn_at_once_where_they_sit():
    T = SE3.exp([0.3, 0.2, 0.1, 0.4, 0.5, 0.6])
    parts = body_parts([solid("box", 1, 1, 1), solid("sphere", 1, rgba=BLUE), solid("box", 1, 2, 3, T=T)])
    assert list(parts) == ["body"]
    assert list(parts["body"]) == [RED, BLUE]
    both = parts["body"][RED]
    assert_allclose(volume_m3(both), 8 + 48, rtol=1e-5)
    places = T.apply(solid_mesh(solid("box", 1, 2, 3)).vertices_m)
    assert all(np.linalg.norm(both.vertices_m - place, axis=1).min() < 1e-5 for place in places)


def test_equal_bodies_have_equal_meshes_to_be_stored_once():
    replay = made_up_replay(0.5)
    parts = body_parts(replay.solids)
    first, other = (next(iter(parts[body].values())) for body in ("block0", "block3"))
    assert (first.vertices_m == other.vertices_m).all()
