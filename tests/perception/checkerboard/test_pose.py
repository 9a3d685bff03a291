from dataclasses import replace

import numpy as np
import pytest

from painted_board import BOARD, RIG, corners, poses
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard.pose import board_pose


@pytest.mark.parametrize("T", poses(5, seed=4))
def test_exact_corners_give_the_pose(T):
    found = board_pose(BOARD, RIG, *corners(T))
    np.testing.assert_allclose(found.T_left_board.matrix, T.matrix, atol=1e-7)
    assert found.rms_px < 1e-4


def test_both_eyes_find_it_better_than_their_noise_suggests():
    """Seventy corners, each off by .1 px on each axis."""
    rng, off, rms_px = np.random.default_rng(0), [], []
    for T in poses(25, seed=5):
        left, right = (px + 0.1 * rng.standard_normal(px.shape) for px in corners(T))
        found = board_pose(BOARD, RIG, left, right)
        off.append((T.inverse() @ found.T_left_board).log())
        rms_px.append(found.rms_px)
    assert np.mean(rms_px) == pytest.approx(0.1 * np.sqrt(2.0 - 6 / 140), rel=0.03)
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert rms[:3].max() < 0.05e-3 and np.degrees(rms[3:]).max() < 0.06


def test_a_board_seen_almost_face_on_is_not_taken_for_its_mirror_image():
    rng = np.random.default_rng(1)
    for tilt in (0.02, 0.05, 0.1):
        T = SE3.from_parts(SO3.exp([tilt, -tilt, 0.4]), (0.02, 0.0, 0.3))
        left, right = (px + 0.15 * rng.standard_normal(px.shape) for px in corners(T))
        off = (T.inverse() @ board_pose(BOARD, RIG, left, right).T_left_board).rotation.angle()
        assert off < np.radians(0.4)


def test_a_board_that_only_one_eye_could_see_has_no_pose():
    """The other eye is 1 m ahead: the board is behind it."""
    rig = replace(RIG, T_left_right=SE3.from_parts(translation_m=[0.05, 0.0, 1.0]))
    with pytest.raises(TrocarError, match="no pose before both eyes explains the corners"):
        board_pose(BOARD, rig, *corners(poses(1)[0]))


def test_wrong_shapes_are_refused():
    left, right = corners(poses(1)[0])
    with pytest.raises(TrocarError, match=r"got \(70, 2\) and \(69, 2\)"):
        board_pose(BOARD, RIG, left, right[1:])
    with pytest.raises(TrocarError, match=r"corners need shape \(70, 2\)"):
        board_pose(BOARD, RIG, left[:-1], right)
