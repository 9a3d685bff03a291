"""Shapes of the pegboard and of the triangular blocks of the FLS peg transfer, as manufactured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3

GRID_X_MM = (-40.5, -11.6)
GRID_Y_MM = (-17.5, 0.0, 17.5)
HEXAGON_MM = ((6.7, -10.9), (6.7, 10.9), (23.7, -25.6), (23.7, 25.6), (40.7, -10.9), (40.7, 10.9))
"""Pegs of the authors' board: a 3 x 2 grid (pitch 28.9 x 17.5) and a hexagon (half-width 17, half-height 25.6).

Derived from the place poses recorded on the robot of Hwang et al. 2022; the middle of the pegs is at x = 134.2 mm in
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
        pegs_off_m: (x, y) displacement of each peg from its place on the authors' board; empty: none.
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

    @property
    def rim_m(self) -> NDArray[np.float64]:
        """Return the corners (4, 3) of the top plate in the board frame, in order."""
        width, depth, height = self.plates_m[0]
        return np.array([(x * width, y * depth, 2 * height) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) / 2


HOLE_MM = ((0, 3.85), (10, 4.03), (20, 4.42), (30, 4.90), (45, 4.80), (60, 4.80))
"""Radius of the hole over the angle in degrees from the middle of a side to the next corner.

Measured on the top face of the authors' model (`shared/data/dvrk/blocks/capture: block_top_model_mm`), averaged over
its six-fold symmetry.
"""
GRASP_OFF_MIDDLE_DEG = 11.0
"""Angle, seen from the block's middle, between the middle of a side and a grasp point 1 mm beside it."""


@dataclass(frozen=True)
class Block:
    """Rounded triangular prism with a hole, in the frame of the authors' model.

    The origin is the middle of the top face. The x axis is parallel to one side, which lies at y = +5.57 mm; the
    opposite corner is at y = -8.95 mm. **z points into the block**, away from a viewer of its top face. The block is
    symmetric under rotations by 120 deg about z.

    Attributes:
        side_m: distance of a side from the middle.
        corner_m: distance of a corner's tip from the middle.
        height_m: extent along z.
        density_kg_m3: printed ABS (assumed).
        hole_wider_m: the hole's radius minus that of the model.
    """

    side_m: float = 5.57e-3
    corner_m: float = 8.95e-3
    height_m: float = 14.9e-3
    density_kg_m3: float = 1040.0
    hole_wider_m: float = 0.0

    @property
    def corner_radius_m(self) -> float:
        """Return the radius of the corners' circles: tangent to both sides, with the tip at ``corner_m``."""
        return 2 * self.side_m - self.corner_m

    def hole_radius_m(self, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the hole's radius in the direction ``angle_rad`` from +x (...,)."""
        from_side = np.degrees(np.asarray(angle_rad)) - 90.0
        folded = np.abs((from_side + 60.0) % 120.0 - 60.0)
        angles, radii = np.array(HOLE_MM).T
        return 1e-3 * np.interp(folded, angles, radii) + self.hole_wider_m

    def outer_radius_m(self, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the outline's radius in the direction ``angle_rad`` from +x (...,)."""
        from_side = np.degrees(np.asarray(angle_rad)) - 90.0
        folded = np.radians(np.abs((from_side + 60.0) % 120.0 - 60.0))
        flat = self.side_m / np.cos(folded)
        centre = self.corner_m - self.corner_radius_m
        off = np.radians(60.0) - folded
        under = np.maximum(self.corner_radius_m**2 - (centre * np.sin(off)) ** 2, 0.0)
        arc = centre * np.cos(off) + np.sqrt(under)
        return np.where(folded <= self.tangent_rad, flat, arc)

    @cached_property
    def rim_m(self) -> NDArray[np.float64]:
        """Return the outline of the top face (120, 3)."""
        angle = np.linspace(-np.pi, np.pi, 120, endpoint=False)
        radius = self.outer_radius_m(angle)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)])

    def gap_m(self, T_a: SE3, T_b: SE3) -> float:
        """Return the gap between two upright blocks, measured along their radii; negative if they overlap."""
        gaps = []
        for first, second in ((T_a, T_b), (T_b, T_a)):
            x, y, _ = (second.inverse() @ first).apply(self.rim_m).T
            gaps.append(np.min(np.hypot(x, y) - self.outer_radius_m(np.arctan2(y, x))))
        return float(min(gaps))

    @cached_property
    def wall_middle_m(self) -> float:
        """Return the distance from the block's middle to the middle of a wall, where jaws close on it."""
        return 0.5 * (self.side_m + float(self.hole_radius_m(np.radians(90.0 + GRASP_OFF_MIDDLE_DEG))))

    @cached_property
    def tangent_rad(self) -> float:
        """Return the angle from the middle of a side to where the rounding of its corner begins."""
        centre = self.corner_m - self.corner_radius_m
        return float(np.arctan2(centre * np.sin(np.radians(60.0)), self.side_m))

    def corners_m(self) -> NDArray[np.float64]:
        """Return the centres (3, 3) of the corners' circles on the top face."""
        angle = np.radians(90.0 + 60.0 + 120.0 * np.arange(3))
        radius = self.corner_m - self.corner_radius_m
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(3)])

    def convex_pieces(self) -> list[NDArray[np.float64]]:
        """Return the nine convex pieces of the prism as corner points (2 k, 3) in m, in the block frame.

        There are three walls along the sides, where the hole bulges inwards, and two pieces at each corner. The chords
        that replace the hole's outline are at most 0.17 mm inside the true hole.
        """
        pieces = []
        for side in range(3):
            middle = np.radians(90.0 + 120.0 * side)
            walls = [
                ([-30, 0, 30], [30, -30]),
                ([30, 60], [60, 54, np.degrees(self.tangent_rad), 30]),
                ([60, 90], [90, 120 - np.degrees(self.tangent_rad), 66, 60]),
            ]
            for inner_deg, outer_deg in walls:
                inner = middle + np.radians(inner_deg)
                outer = middle + np.radians(outer_deg)
                angle = np.concatenate([inner, outer])
                radius = np.concatenate([self.hole_radius_m(inner), self.outer_radius_m(outer)])
                flat = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
                top = np.column_stack([flat, np.zeros(len(flat))])
                pieces.append(np.concatenate([top, top + [0, 0, self.height_m]]))
        return pieces

    def top_face_m(self, spacing_m: float = 0.4e-3) -> NDArray[np.float64]:
        """Return points (n, 3) on the top face, on a square grid with this spacing."""
        ticks = np.arange(-self.corner_m, self.corner_m + spacing_m, spacing_m)
        x, y = (a.ravel() for a in np.meshgrid(ticks, ticks))
        radius, angle = np.hypot(x, y), np.arctan2(y, x)
        keep = (radius >= self.hole_radius_m(angle)) & (radius <= self.outer_radius_m(angle))
        return np.column_stack([x, y, np.zeros_like(x)])[keep]
