"""The important part of a scene fills the frame of a picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.perception.depth import project
from trocar.sim.offscreen import FILLED, HEIGHTS, framed, look_at

EYE_M = np.array([0.13, -0.46, 0.33])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.06, 0.15]))
def test_points_reach_from_edge_to_edge_and_none_is_outside(seed, size_m):
    points = np.random.default_rng(seed).uniform(-size_m, size_m, (12, 3))
    T_world_camera, lens = framed(EYE_M, points)
    uv = np.array([project(lens, p) for p in T_world_camera.inverse().apply(points)])
    low, high = uv.min(axis=0), uv.max(axis=0)
    assert (low >= 0).all() and high[0] <= lens.width - 1 and high[1] <= lens.height - 1
    filled = (high - low) / [lens.width, lens.height]
    assert filled.max() == pytest.approx(FILLED, abs=0.02)
    assert (low + high) / 2 == pytest.approx([(lens.width - 1) / 2, (lens.height - 1) / 2], abs=0.1)
    assert HEIGHTS[0] - 0.01 <= lens.height / lens.width <= HEIGHTS[1] + 0.01


def test_the_picture_is_level_and_smaller_at_a_smaller_scale():
    points = np.array([[-0.05, -0.02, 0.0], [0.05, 0.02, 0.03]])
    (T_world_camera, large), (_, small) = framed(EYE_M, points), framed(EYE_M, points, 0.5)
    assert T_world_camera.rotation.matrix[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert small.width * 2 == large.width and small.fx * 2 == pytest.approx(large.fx)


def test_what_lies_behind_the_eye_does_no_harm():
    T_world_camera, lens = framed(EYE_M, np.array([[0.0, 0.0, 0.0], [0.2, -0.9, 0.6]]))
    assert np.isfinite(T_world_camera.matrix).all() and lens.fx > 0


@pytest.mark.parametrize(("tall_m", "height_px"), [(0.02, 358), (0.065, 416), (0.3, 480)])
def test_a_picture_is_640_pixels_wide_and_as_high_as_what_is_in_it_within_bounds(tall_m, height_px):
    points = np.array([[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.0, tall_m], [0.0, 0.0, 0.0]])
    _, lens = framed(np.array([0.0, -5.0, tall_m / 2]), points)  # from so far away that all is at one distance
    assert (lens.width, lens.height) == (640, pytest.approx(height_px, abs=1))
    assert (lens.cx, lens.cy) == (319.5, (lens.height - 1) / 2) and lens.fx == lens.fy
    wide, tall = lens.fx * 0.1 / 5, lens.fy * tall_m / 5
    assert max(wide / 640, tall / lens.height) == pytest.approx(0.94, rel=0.01)


def test_a_level_camera_looks_at_its_target_with_the_world_upright():
    eye, target = np.array([0.3, -0.4, 0.5]), np.array([0.1, 0.2, 0.1])
    T = look_at(eye, target)
    seen = T.inverse().apply(target)
    assert seen == pytest.approx([0, 0, np.linalg.norm(target - eye)])
    assert T.inverse().apply(target + [0, 0, 0.1])[1] < 0, "up in the world is up in the picture"
    right = T.apply([1.0, 0, 0]) - eye
    assert right[2] == pytest.approx(0.0) and np.cross(right, [0, 0, 1])[:2] @ (eye - target)[:2] > 0
    assert T.translation_m == pytest.approx(eye)


def test_what_is_too_near_counts_as_two_centimetres_away():
    beside = np.array([[0.0, 1.0, 0.0], [0.01, 1.0, 0.0], [0.001, 0.001, 0.0]])
    _, lens = framed(np.zeros(3) + [0, 0, 1e-9], beside)
    assert lens.fx > 500, "a point a millimetre before the lens does not fill the picture"


def test_points_in_one_place_do_no_harm():
    _, lens = framed(np.array([0.0, -1.0, 0.0]), np.zeros((2, 3)))
    assert np.isfinite(lens.fx) and lens.width == 640
