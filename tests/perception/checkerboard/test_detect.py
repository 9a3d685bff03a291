import numpy as np
import pytest

from painted_board import BOARD, RIG, corners, picture, poses
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.checkerboard.board import Checkerboard
from trocar.perception.checkerboard.detect import find_corners

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
    empty = np.full((480, 640, 3), 120, dtype=np.uint8)
    assert find_corners(BOARD, empty) is None
    image = picture(RIG.left, FACING)
    assert find_corners(Checkerboard(columns=12, rows=7), image) is None
    assert find_corners(BOARD, np.ascontiguousarray(image[:, :300])) is None


@pytest.mark.parametrize("image", [np.zeros((480, 640), np.uint8), np.zeros((480, 640, 3))])
def test_other_arrays_are_refused(image):
    with pytest.raises(TrocarError, match="uint8, got"):
        find_corners(BOARD, image)
