import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.perception.checkerboard.board import Checkerboard


def test_corners_are_row_by_row_about_the_middle():
    corners = Checkerboard(columns=4, rows=3, square_m=0.01).corners_m
    np.testing.assert_allclose(corners[:4, 0], [-0.015, -0.005, 0.005, 0.015])
    np.testing.assert_allclose(corners[::4, 1], [-0.01, 0.0, 0.01])
    assert corners.shape == (12, 3) and not corners[:, 2].any()


def test_every_inner_corner_touches_two_black_and_two_white_squares():
    board = Checkerboard(columns=4, rows=3, square_m=0.01)
    middles, black = board.squares_m
    assert black[0] and len(middles) == 20
    for corner in board.corners_m:
        near = np.linalg.norm(middles - corner, axis=-1) < 0.75 * board.square_m
        assert near.sum() == 4 and black[near].sum() == 2


def test_half_a_turn_changes_the_colours():
    board = Checkerboard()
    assert (board.inner_black != board.inner_black[::-1, ::-1]).all()


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"columns": 9, "rows": 7}, "9 x 7 inner corners looks the same after half a turn"),
        ({"columns": 2, "rows": 7}, "columns = 2"),
        ({"rows": 41}, "rows = 41"),
        ({"square_m": 0.0}, "square of 0.0 m"),
    ],
)
def test_a_board_that_cannot_be_found_is_refused(values, says):
    with pytest.raises(TrocarError, match=says):
        Checkerboard(**values)
