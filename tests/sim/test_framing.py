"""The important part of a scene fills the frame of a picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.perception.depth import project
from trocar.sim.framing import FILLED, HEIGHTS, framed

EYE_M = np.array([0.13, -0.46, 0.33])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.06, 0.15]))
def test_points_reach_from_edge_to_edge_and_none_is_outside(seed, size_m):
    points = np.random.default_rng(seed).uniform(-size_m, size_m, (12, 3))
    framing = framed(EYE_M, points)
    lens = framing.lens
    uv = np.array([project(lens, p) for p in framing.T_world_camera.inverse().apply(points)])
    low, high = uv.min(axis=0), uv.max(axis=0)
    assert (low >= 0).all() and high[0] <= lens.width - 1 and high[1] <= lens.height - 1
    filled = (high - low) / [lens.width, lens.height]
    assert filled.max() == pytest.approx(FILLED, abs=0.02)
    assert (low + high) / 2 == pytest.approx([(lens.width - 1) / 2, (lens.height - 1) / 2], abs=2.0)
    assert HEIGHTS[0] - 0.01 <= lens.height / lens.width <= HEIGHTS[1] + 0.01


def test_the_picture_is_level_and_smaller_at_a_smaller_scale():
    points = np.array([[-0.05, -0.02, 0.0], [0.05, 0.02, 0.03]])
    large, small = framed(EYE_M, points), framed(EYE_M, points, 0.5)
    assert large.T_world_camera.rotation.matrix[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert small.lens.width * 2 == large.lens.width and small.lens.fx * 2 == pytest.approx(large.lens.fx)


def test_what_lies_behind_the_eye_does_no_harm():
    framing = framed(EYE_M, np.array([[0.0, 0.0, 0.0], [0.2, -0.9, 0.6]]))
    assert np.isfinite(framing.T_world_camera.matrix).all() and framing.lens.fx > 0
