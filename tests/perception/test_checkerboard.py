import numpy as np
import pytest

from trocar.errors import InvalidInput
from trocar.perception.checkerboard import Checkerboard


def test_corners_are_row_by_row_about_the_middle():
    corners = Checkerboard(columns=4, rows=3, square_m=0.01).corners_m
    np.testing.assert_allclose(corners[:4, 0], [-0.015, -0.005, 0.005, 0.015])
    np.testing.assert_allclose(corners[::4, 1], [-0.01, 0.0, 0.01])
    assert corners.shape == (12, 3) and not corners[:, 2].any()


def test_half_a_turn_changes_the_colours():
    board = Checkerboard()
    assert (board.inner_black != board.inner_black[::-1, ::-1]).all()


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"columns": 9, "rows": 7}, "9 x 7 inner corners looks the same after half a turn"),
        ({"columns": 2, "rows": 7}, "number of columns is 2; give 3 to 40"),
        ({"rows": 2, "columns": 9}, "number of rows is 2; give 3 to 40"),
        ({"rows": 41}, "number of rows is 41; give 3 to 40"),
        ({"columns": 41, "rows": 8}, "number of columns is 41; give 3 to 40"),
        ({"square_m": -8e-3}, "square is -0.008 m"),
        ({"square_m": 0.11}, "square is 0.11 m"),
        ({"square_m": float("nan")}, "square is nan m"),
        ({"square_m": 0.0}, "square is 0.0 m"),
    ],
)
def test_a_board_that_cannot_be_found_is_refused(values, says):
    with pytest.raises(InvalidInput, match=says):
        Checkerboard(**values)


def test_the_smallest_and_the_largest_boards_are_boards():
    assert Checkerboard(columns=3, rows=40, square_m=0.1).corners_m.shape == (120, 3)
    assert Checkerboard(columns=40, rows=3).corners_m.shape == (120, 3)


def test_the_board_that_is_printed_if_nothing_is_said():
    """Ten by seven inner corners of 8 mm, which fits on a postcard."""
    assert Checkerboard().corners_m.shape == (70, 3)
    assert Checkerboard().size_m == pytest.approx((0.088, 0.064))


def test_squares_alternate_from_a_black_one_and_lie_between_the_corners():
    board = Checkerboard(columns=4, rows=3, square_m=0.01)
    middles, black = board.squares_m
    np.testing.assert_allclose(middles[:5, 0], [-0.02, -0.01, 0.0, 0.01, 0.02], atol=1e-12)
    np.testing.assert_allclose(middles[::5, 1], [-0.015, -0.005, 0.005, 0.015])
    assert black.reshape(4, 5).tolist() == [[(row + column) % 2 == 0 for column in range(5)] for row in range(4)]
    np.testing.assert_array_equal(board.inner_black, black.reshape(4, 5)[1:-1, 1:-1])
    assert board.size_m == pytest.approx((0.05, 0.04))
