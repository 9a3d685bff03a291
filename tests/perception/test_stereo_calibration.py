"""Corners of a painted checkerboard, the lenses of the pair that sees it, and its pose."""

from dataclasses import replace

import numpy as np
import pytest

from painted_board import BOARD, RIG, corners, picture, poses
from trocar.errors import InvalidInput
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.stereo import triangulate
from trocar.perception.stereo_calibration import _in_order, _refined, board_pose, calibrate_stereo, find_corners

FACING = SE3.from_parts(SO3.exp([0.3, -0.2, 0.0]), (0.02, 0.0, 0.28))


def turned(degrees: float) -> SE3:
    return FACING @ SE3.from_parts(SO3.axis("z", np.radians(degrees)))


@pytest.mark.parametrize("degrees", [0, 60, 90, 135, 180, 215, 270])
def test_corners_have_the_boards_order_however_it_is_turned(degrees):
    T = turned(degrees)
    found = find_corners(BOARD, picture(RIG.left, T))
    assert found is not None
    off = np.linalg.norm(found - corners(T)[0], axis=-1)
    assert np.sqrt(np.mean(off**2)) < 0.2 and off.max() < 0.6


@pytest.mark.parametrize(("light", "haze"), [(0.1, 0), (0.4, 0), (1.0, 0), (3.0, 0), (0.3, 190)])
def test_exposure_and_haze_do_not_matter(light, haze):
    found = find_corners(BOARD, (picture(RIG.left, FACING, light=light) + haze).astype(np.uint8))
    assert found is not None
    assert np.sqrt(np.mean((found - corners(FACING)[0]) ** 2)) < 0.25


def test_corners_are_unbiased():
    off = []
    for T in poses(6, seed=3):
        found = find_corners(BOARD, picture(RIG.left, T, noise=1.0))
        assert found is not None
        off.append(found - corners(T)[0])
    assert np.abs(np.mean(off, axis=(0, 1))).max() < 0.01


def test_no_board_another_board_and_half_a_board_are_not_found():
    empty = np.full((240, 320, 3), 120, dtype=np.uint8)
    assert find_corners(BOARD, empty) is None
    image = picture(RIG.left.binned(2), FACING)
    assert find_corners(BOARD, image) is not None
    assert find_corners(Checkerboard(columns=12, rows=7), image) is None
    assert find_corners(BOARD, np.ascontiguousarray(image[:, :150])) is None


# Corners that were found somehow, in the board's order.

UPRIGHT = Checkerboard(columns=4, rows=3, square_m=0.01)
EXACT = 20.0 + 12.0 * np.stack(np.meshgrid(np.arange(4), np.arange(3)), -1)
"""Corners (rows, columns, 2) of that board in ``drawn``."""


def drawn(black=20, white=200):
    """Return a picture (68, 80) of the board whose first corner is at (20, 20), of squares of 12 px."""
    column, row = (np.arange(80) + 4) // 12, (np.arange(68) + 4) // 12
    squares = np.where((column[None] + row[:, None]) % 2 == 0, black, white)  # that beyond the first corner is black
    return squares[:68, :80].astype(np.uint8)


@pytest.mark.parametrize("contrast", [180, 4])
def test_corners_are_put_in_order_however_they_were_found(contrast):
    """Right-handed, and the square at the first of them black: also if the search began elsewhere."""
    gray = drawn(60, 60 + contrast)
    for turned_about in (EXACT, EXACT[::-1, ::-1], EXACT[:, ::-1], EXACT[::-1]):
        found = _in_order(UPRIGHT, turned_about, gray)
        np.testing.assert_array_equal(found, EXACT.reshape(-1, 2))
    other = _in_order(UPRIGHT, EXACT, 255 - gray)
    np.testing.assert_array_equal(other, EXACT[::-1, ::-1].reshape(-1, 2))


def test_two_grey_levels_of_contrast_are_no_board():
    assert _in_order(UPRIGHT, EXACT, drawn(100, 102)) is None
    assert _in_order(UPRIGHT, EXACT, drawn(102, 100)) is None


def test_a_board_at_the_images_border_is_put_in_order_too():
    """Of which the outer squares' middles are beside the image: its last pixels count."""
    small = drawn()[27:36, 27:48]
    np.testing.assert_array_equal(_in_order(UPRIGHT, EXACT - 27.0, small), EXACT.reshape(-1, 2) - 27.0)


def test_corners_are_moved_to_the_saddles_nearby_and_not_farther():
    """Corners of whole squares lie between pixels: half a pixel up and to the left."""
    rng = np.random.default_rng(0)
    true = EXACT - 0.5
    start = true + rng.uniform(-0.7, 0.7, true.shape)
    start[1, 2] = true[1, 2] + [2.2, 0.0]  # it would have to go too far
    found = _refined(start, drawn())
    assert np.abs(np.delete((found - true).reshape(-1, 2), 6, axis=0)).max() < 0.06
    np.testing.assert_array_equal(found[1, 2], start[1, 2])


def test_a_corner_is_refined_by_what_is_nearer_than_its_neighbours():
    """Squares of 6 px: a window of 2 px on either side holds no other corner."""
    small = drawn().reshape(34, 2, 40, 2)[:, 0, :, 0]
    true = EXACT / 2.0 - 0.5
    found = _refined(true + [0.4, -0.3], np.ascontiguousarray(small))
    assert np.abs(found - true).max() < 0.1


@pytest.mark.parametrize("axis", [0, 1])
def test_a_board_seen_at_a_slant_is_refined_by_its_narrower_squares(axis):
    """Squares of 12 px by 72: a window for 72 would hold the corners on either side."""
    wide = np.repeat(drawn(), 6, axis=axis)
    true = EXACT - 0.5
    true[..., 1 - axis] = 6.0 * EXACT[..., 1 - axis] - 0.5
    found = _refined(true + [0.3, -0.2], np.ascontiguousarray(wide))
    assert np.abs(found - true).max() < 0.1


# Lenses.

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
    with pytest.raises(InvalidInput, match="5 views in which both eyes see the whole board are too few"):
        calibrate_stereo(BOARD, left, right, SIZE)
    for both in ((left[:, :30], right), (left, right[:, :30])):
        with pytest.raises(InvalidInput, match=r"corners of both eyes .* they need \(5, 70, 2\)"):
            calibrate_stereo(BOARD, *both, SIZE)


# The pose of a board.


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
    with pytest.raises(InvalidInput, match="fit no pose before both eyes"):
        board_pose(BOARD, rig, *corners(poses(1)[0]))


def test_corners_of_another_board_have_no_pose():
    left, right = corners(poses(1)[0])
    for both in ((left, right[1:]), (left[:-1], right)):
        with pytest.raises(InvalidInput, match=r"they need \(70, 2\)"):
            board_pose(BOARD, RIG, *both)
