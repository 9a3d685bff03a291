"""A printed checkerboard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry.arrays import Array

MIN_CORNERS, MAX_CORNERS = 3, 40  # least and greatest number of inner corners along one side
MAX_SQUARE_M = 0.1
MIN_VIEWS = 6  # minimum number of views of a board to calibrate the lenses of a pair


@dataclass(frozen=True)
class Checkerboard:
    """A checkerboard; its frame has the origin in the middle, x along the columns, y along the rows, z into the board.

    The frame of a board held upright before a camera is parallel to the camera's. The square at the least x and y is
    black. One number of corners is odd, the other even, so that the board looks different after half a turn.
    """

    columns: int = 10  # inner corners along x
    rows: int = 7  # inner corners along y
    square_m: float = 8e-3  # side of a square

    def __post_init__(self) -> None:
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if not MIN_CORNERS <= count <= MAX_CORNERS:
                remedy = f"give {MIN_CORNERS} to {MAX_CORNERS} inner corners"
                raise InvalidValue(f"a checkerboard's number of {name}", count, remedy)
        if (self.columns + self.rows) % 2 == 0:
            problem = "looks the same after half a turn"
            remedy = "make one of the two numbers odd and the other even"
            raise InvalidInput(f"a checkerboard of {self.columns} x {self.rows} inner corners", problem, remedy)
        if not 0.0 < self.square_m <= MAX_SQUARE_M:
            raise InvalidValue("a checkerboard's square", f"{self.square_m} m", f"give one in (0, {MAX_SQUARE_M}] m")

    @property
    def corners_m(self) -> Array:
        """Return the inner corners (rows * columns, 3) in the board's frame, row by row."""
        return self._grid(self.columns, self.rows)

    @property
    def size_m(self) -> tuple[float, float]:
        """Return width and height of all squares."""
        return (self.columns + 1) * self.square_m, (self.rows + 1) * self.square_m

    @property
    def squares_m(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the middles (n, 3) of all squares in the board's frame, and which of them are black."""
        column, row = np.meshgrid(np.arange(self.columns + 1), np.arange(self.rows + 1))
        return self._grid(self.columns + 1, self.rows + 1), ((column + row) % 2 == 0).ravel()

    @property
    def inner_black(self) -> NDArray[np.bool_]:
        """Return which of the squares between four inner corners (rows - 1, columns - 1) are black."""
        column, row = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return (column + row) % 2 == 0

    def _grid(self, columns: int, rows: int) -> Array:
        x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
        grid = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float64)
        return self.square_m * grid
