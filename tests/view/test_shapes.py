"""Shapes are closed, face outwards and have the sizes they should."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.arms import ARMS, frames
from trocar.sutures import Needle
from trocar.view import shapes


def volume_m3(mesh):
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def edges_cancel(mesh):
    """Return whether each edge is passed once in each direction: closed, with faces turned alike."""
    _, same = np.unique(np.round(mesh.vertices_m, 7), axis=0, return_inverse=True)
    faces = same.ravel()[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth = {tuple(pair) for pair in pairs.tolist()}
    return len(forth) == len(pairs) and all((b, a) in forth for a, b in forth)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_straight_tube_is_a_prism_whatever_its_direction(seed):
    rng = np.random.default_rng(seed)
    start, end = rng.normal(size=(2, 3))
    sides, radius = 12, 0.1
    mesh = shapes.tube([start, end], radius, sides)
    expected = sides / 2 * np.sin(2 * np.pi / sides) * radius**2 * np.linalg.norm(end - start)
    assert_allclose(volume_m3(mesh), expected, rtol=1e-3)


@pytest.mark.parametrize(
    "mesh",
    [
        shapes.tube([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 1, 2]], 0.1),
        shapes.tube([[0, 0, 0], [1, 2, 3], [1, 2, 3], [2, 4, 6]], [0.05, 0.05, 0.12, 0.0]),
        shapes.finger(),
        shapes.wire(Needle()),
        *(shapes.shaft(arm) for arm in ARMS.values()),
    ],
)
def test_shapes_are_closed_and_face_outwards(mesh):
    assert mesh.faces.max() < len(mesh.vertices_m)
    assert edges_cancel(mesh)
    assert volume_m3(mesh) > 0


@pytest.mark.parametrize("needle", [Needle(), Needle(0.012, np.radians(120))], ids=str)
def test_the_needle_goes_from_its_tip_back_along_its_arc(needle):
    line = shapes.needle_arc_m(needle)
    assert_allclose(np.linalg.norm(line, axis=1), needle.radius_m)
    assert_allclose(line[0], [0, -needle.radius_m, 0], atol=1e-15)
    assert line[1, 0] < 0  # the tip moves along x, so the wire lies behind it
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    assert_allclose(length, needle.radius_m * needle.arc_rad, rtol=1e-3)


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_the_shaft_comes_from_the_remote_centre_and_the_link_ends_at_the_jaws(arm):
    T = frames(arm, arm.middle)
    shaft = T[4].apply(shapes.shaft(arm).vertices_m.astype(float))
    wrist, centre = T.matrix[4, :3, 3], np.zeros(3)
    along = (shaft - wrist) @ (centre - wrist) / np.sum((centre - wrist) ** 2)
    assert along.min() > -1e-6
    assert along.max() > 1
    link = T[5].apply(shapes.wrist_link(arm).vertices_m.astype(float))
    assert np.linalg.norm(link - T.matrix[6, :3, 3], axis=1).min() < 1e-6
