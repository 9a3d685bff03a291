"""The board with twelve pegs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GRID_X_MM = (-40.5, -11.6)
GRID_Y_MM = (-17.5, 0.0, 17.5)
HEXAGON_MM = ((6.7, -10.9), (6.7, 10.9), (23.7, -25.6), (23.7, 25.6), (40.7, -10.9), (40.7, 10.9))
"""Pegs of the authors' board: a 3 x 2 grid (pitch 28.9 x 17.5) and a hexagon (half-width 17, half-height 25.6).

Derived from the place poses recorded on the robot (facts/peg_transfer.md); the middle of the pegs is at x = 134.2 mm in
PSM1's base frame.
"""


@dataclass(frozen=True)
class Pegboard:
    """Twelve pegs on a plate.

    Board frame: origin on the plate's surface in the middle of the pegs, z up along the pegs, x to the right and y away
    as seen by the camera. Pegs are numbered by x, then y: 0-5 are the grid on the left, 6-11 the hexagon on the right.

    Attributes:
        peg_radius_m: half of the 3.5 mm seen in the photographs (which contradict the 2.25 mm in the text).
        peg_height_m: height from the plate to the rounded top.
        pegs_off_m: (x, y) of each peg's foot against the authors' board; empty: none is off.
        plates_m: (width, depth, height of the top above the pegs' feet) of the stepped plates, top plate first.
    """

    peg_radius_m: float = 1.75e-3
    peg_height_m: float = 20e-3
    pegs_off_m: tuple[tuple[float, float], ...] = ()
    plates_m: tuple[tuple[float, float, float], ...] = (
        (0.100, 0.064, 0.0),
        (0.122, 0.083, -0.004),
        (0.152, 0.105, -0.009),
    )

    @property
    def pegs_m(self) -> NDArray[np.float64]:
        """Return the feet of the pegs (12, 3) in the board frame."""
        grid = [(x, y) for x in GRID_X_MM for y in GRID_Y_MM]
        feet = np.array([(x, y, 0.0) for x, y in (*grid, *HEXAGON_MM)]) * 1e-3
        if self.pegs_off_m:
            feet[:, :2] += self.pegs_off_m
        return feet
