import numpy as np
import pytest

from painted_board import BOARD, RIG, corners, picture, poses
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard.board import Checkerboard
from trocar.perception.checkerboard.detect import _in_order, _refined, find_corners

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


@pytest.mark.parametrize("light", [0.1, 0.4, 1.0, 3.0])
def test_exposure_does_not_matter(light):
    found = find_corners(BOARD, picture(RIG.left, FACING, light=light))
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


def test_a_board_behind_haze_is_found():
    hazy = (picture(RIG.left, FACING, light=0.3) + 190).astype(np.uint8)
    found = find_corners(BOARD, hazy)
    assert found is not None
    assert np.sqrt(np.mean((found - corners(FACING)[0]) ** 2)) < 0.25


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((480, 640), np.uint8),
        np.zeros((480, 640, 3)),
        np.zeros((480, 3), np.uint8),
        np.zeros((480, 640, 4), np.uint8),
    ],
)
def test_other_arrays_are_refused(image):
    with pytest.raises(TrocarError, match="uint8, got"):
        find_corners(BOARD, image)


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
