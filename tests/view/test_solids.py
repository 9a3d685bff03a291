"""Solids have the shapes and sizes that the replay gives them, at their place on the body."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from triangles import edges_cancel, volume_m3

from made_up_replay import made_up_replay
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.replay import Solid
from trocar.view.solids import body_parts, solid_mesh

RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.5)
LENGTH = st.floats(1e-4, 1.0)


NONE = np.zeros((0, 3))


def solid(shape, *size_m, vertices_m=NONE, rgba=RED, body="body", T=None):
    return Solid(body, shape, size_m, T or SE3.identity(), rgba, vertices_m)


def extent(mesh):
    return mesh.vertices_m.max(0).astype(float), mesh.vertices_m.min(0).astype(float)


@given(a=LENGTH, b=LENGTH, c=LENGTH)
def test_shapes_fill_their_box_and_are_closed(a, b, c):
    for shape, size_m, half in (
        ("box", (a, b, c), (a, b, c)),
        ("sphere", (a,), (a, a, a)),
        ("capsule", (a, b), (a, a, a + b)),
        ("cylinder", (a, b), (a, a, b)),
    ):
        mesh = solid_mesh(solid(shape, *size_m))
        high, low = extent(mesh)
        assert_allclose(high, half, rtol=1e-5)
        assert_allclose(low, -np.array(half), rtol=1e-5)
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


def test_a_hull_is_its_corners():
    corners = np.random.default_rng(1).normal(size=(8, 3))
    high, low = extent(solid_mesh(solid("hull", vertices_m=corners)))
    assert_allclose(high, corners.max(0), rtol=1e-6)
    assert_allclose(low, corners.min(0), rtol=1e-6)


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
    assert [part.rgba for part in parts["body"]] == [RED, BLUE]
    both = parts["body"][0].mesh
    assert_allclose(volume_m3(both), 8 + 48, rtol=1e-5)
    places = T.apply(solid_mesh(solid("box", 1, 2, 3)).vertices_m)
    assert all(np.linalg.norm(both.vertices_m - place, axis=1).min() < 1e-5 for place in places)


def test_equal_bodies_have_equal_meshes_to_be_stored_once():
    replay = made_up_replay(0.5)
    parts = body_parts(replay.solids)
    assert (parts["block0"][0].mesh.vertices_m == parts["block3"][0].mesh.vertices_m).all()
