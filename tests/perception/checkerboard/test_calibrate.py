import numpy as np
import pytest

from painted_board import BOARD, RIG, corners, picture, poses
from trocar.errors import TrocarError
from trocar.perception.checkerboard.calibrate import calibrate_stereo
from trocar.perception.checkerboard.detect import find_corners
from trocar.perception.stereo import triangulate

SIZE = (640, 480)


def seen(views):
    both = [corners(T) for T in views]
    return np.array([left for left, _ in both]), np.array([right for _, right in both])


def off_m(rig, views):
    """Return how far corners of some boards are found from where they are."""
    left, right = seen(views)
    true = np.array([T.apply(BOARD.corners_m) for T in views])
    return np.linalg.norm(triangulate(rig, left, right)[0] - true, axis=-1)


def test_exact_corners_give_the_pair_back():
    found = calibrate_stereo(BOARD, *seen(poses(12)), SIZE)
    assert found.rms_px < 1e-3 and found.views == 12
    for eye in ("left", "right"):
        lens, true = getattr(found.rig, eye), getattr(RIG, eye)
        np.testing.assert_allclose(lens.matrix, true.matrix, atol=0.05)
        np.testing.assert_allclose(lens.distortion[:4], true.distortion[:4], atol=1e-3)
    np.testing.assert_allclose(found.rig.T_left_right.matrix, RIG.T_left_right.matrix, atol=2e-5)
    assert off_m(found.rig, poses(5, seed=9)).max() < 5e-6


def test_noise_of_corners_shows_as_residual_and_leaves_places_right():
    rng = np.random.default_rng(0)
    left, right = (px + 0.1 * rng.standard_normal(px.shape) for px in seen(poses(20)))
    found = calibrate_stereo(BOARD, left, right, SIZE)
    assert 0.11 < found.rms_px < 0.16
    assert off_m(found.rig, poses(5, seed=9)).mean() < 0.25e-3


def test_pictures_give_the_pair():
    views = poses(6, seed=2)
    left, right = (
        np.array([find_corners(BOARD, picture(getattr(RIG, eye), T)) for T in each])
        for eye, each in (("left", views), ("right", [RIG.T_left_right.inverse() @ T for T in views]))
    )
    found = calibrate_stereo(BOARD, left, right, SIZE)
    assert found.rms_px < 0.1
    assert off_m(found.rig, poses(5, seed=9)).mean() < 0.5e-3


def test_six_views_are_enough():
    found = calibrate_stereo(BOARD, *seen(poses(6)), SIZE)
    assert found.views == 6 and found.rms_px < 1e-3
    assert (found.rig.left.width, found.rig.right.height) == SIZE
    assert found.rig.left.distortion[4] == found.rig.right.distortion[4] == 0.0


def test_too_few_views_and_wrong_shapes_are_refused():
    left, right = seen(poses(5))
    with pytest.raises(TrocarError, match=r"got \(5, 30, 2\) and \(5, 70, 2\)"):
        calibrate_stereo(BOARD, left[:, :30], right, SIZE)
    with pytest.raises(TrocarError, match="5 views in which both eyes see the whole board are too few"):
        calibrate_stereo(BOARD, left, right, SIZE)
    with pytest.raises(TrocarError, match=r"corners of both eyes need shape \(5, 70, 2\)"):
        calibrate_stereo(BOARD, left, right[:, :30], SIZE)
