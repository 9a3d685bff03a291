"""Shapes are closed, face outwards and have the sizes they should."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from triangles import edges_cancel, volume_m3

from trocar.arms import ARMS, frames
from trocar.view import shapes

EACH_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)


@EACH_ARM
@pytest.mark.parametrize("shape", [shapes.shaft, shapes.wrist_link, shapes.finger])
def test_pieces_of_an_instrument_are_closed_and_face_outwards(arm, shape):
    assert edges_cancel(shape(arm))
    assert volume_m3(shape(arm)) > 0


@EACH_ARM
def test_the_shaft_comes_from_the_remote_centre_and_the_link_ends_at_the_jaws(arm):
    T = frames(arm, arm.middle)
    shaft = T[4].apply(shapes.shaft(arm).vertices_m.astype(float))
    wrist, centre = T.matrix[4, :3, 3], np.zeros(3)
    along = (shaft - wrist) @ (centre - wrist) / np.sum((centre - wrist) ** 2)
    assert along.min() > -1e-6
    assert along.max() > 1
    link = T[5].apply(shapes.wrist_link(arm).vertices_m.astype(float))
    assert np.linalg.norm(link - T.matrix[6, :3, 3], axis=1).min() < 1e-6


@EACH_ARM
def test_a_finger_points_down_and_lies_on_its_side_of_the_closing_plane(arm):
    low, high = np.sort(shapes.finger(arm).vertices_m, axis=0)[[0, -1]].astype(float)
    instrument = arm.instrument
    assert_allclose([low[0], high[0]], [0.0, instrument.finger_base_m], atol=1e-9)
    assert_allclose(high[1] - low[1], instrument.finger_width_m, rtol=1e-6)
    assert_allclose([low[2], high[2]], [-instrument.finger_length_m, 0.0], atol=1e-9)
