"""Pegboard and block are those of the drawings."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

BLOCK = Block()
ANGLE = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
SIDES_DEG, CORNERS_DEG = np.array([90.0, 210.0, 330.0]), np.array([30.0, 150.0, 270.0])
AREA_M2 = 0.5 * np.mean(BLOCK.outer_radius_m(ANGLE) ** 2 - BLOCK.hole_radius_m(ANGLE) ** 2) * 2 * np.pi


def xy_m(radius_m, angle_rad):
    return np.stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad)], -1)


def test_twelve_pegs_stand_in_a_grid_on_the_left_and_a_hexagon_on_the_right():
    pegs_mm = 1e3 * Pegboard().pegs_m
    grid, hexagon = pegs_mm[:6], pegs_mm[6:]
    assert np.unique(grid[:, 0].round(6)).tolist() == [-40.5, -11.6]
    assert grid[:, 1].round(6).tolist() == [-17.5, 0.0, 17.5] * 2
    off = np.abs(hexagon - [23.7, 0.0, 0.0])
    assert sorted(map(tuple, off.round(6).tolist())) == [(0.0, 25.6, 0.0)] * 2 + [(17.0, 10.9, 0.0)] * 4
    assert pegs_mm.round(6).tolist() == sorted(pegs_mm.round(6).tolist()), "numbered by x, then y"


def test_sizes_are_those_of_the_board_and_the_block():
    board = Pegboard()
    assert (2 * board.peg_radius_m, board.peg_height_m) == (3.5e-3, 20e-3)
    assert board.plates_m == ((0.100, 0.064, 0.0), (0.122, 0.083, -0.004), (0.152, 0.105, -0.009))
    assert (BLOCK.side_m, BLOCK.corner_m, BLOCK.height_m) == (5.57e-3, 8.95e-3, 14.9e-3)


def test_a_peg_that_is_off_is_off_its_own_way():
    off_m = tuple((1e-4 * k, -2e-4 * k) for k in range(12))
    shift = Pegboard(pegs_off_m=off_m).pegs_m - Pegboard().pegs_m
    np.testing.assert_allclose(shift, np.column_stack([off_m, np.zeros(12)]), atol=1e-15)


def test_a_block_is_a_triangle_with_rounded_corners_and_a_hole():
    sides, corners = np.radians(SIDES_DEG), np.radians(CORNERS_DEG)
    np.testing.assert_allclose(BLOCK.outer_radius_m(sides), BLOCK.side_m)
    np.testing.assert_allclose(BLOCK.outer_radius_m(corners), BLOCK.corner_m)
    np.testing.assert_allclose(BLOCK.hole_radius_m(sides), 3.85e-3)
    np.testing.assert_allclose(BLOCK.hole_radius_m(corners), 4.80e-3)
    assert np.ptp(BLOCK.outer_radius_m(ANGLE)) == pytest.approx(BLOCK.corner_m - BLOCK.side_m)
    wider = Block(hole_wider_m=2e-4)
    np.testing.assert_allclose(wider.hole_radius_m(ANGLE) - BLOCK.hole_radius_m(ANGLE), 2e-4)


def test_the_outline_is_flat_up_to_the_rounding_of_a_corner_and_smooth_there():
    rim = xy_m(BLOCK.outer_radius_m(ANGLE), ANGLE)
    inwards = [rim @ xy_m(1.0, side) for side in np.radians(SIDES_DEG)]
    np.testing.assert_allclose(np.max(inwards, axis=1), BLOCK.side_m, rtol=1e-6)
    flat = np.max(inwards, axis=0) > BLOCK.side_m - 1e-9
    to_corner = np.linalg.norm(rim[:, None] - BLOCK.corners_m()[:, :2], axis=-1).min(axis=1)
    np.testing.assert_allclose(to_corner[~flat], BLOCK.corner_radius_m, rtol=1e-6)
    from_side = np.abs((ANGLE - np.radians(90.0) + np.pi / 3) % (2 * np.pi / 3) - np.pi / 3)
    assert from_side[flat].max() == pytest.approx(BLOCK.tangent_rad, abs=2e-3)
    assert from_side[~flat].min() == pytest.approx(BLOCK.tangent_rad, abs=2e-3)


def test_jaws_close_in_the_middle_of_a_wall():
    assert 0.5 * (3.85e-3 + BLOCK.side_m) < BLOCK.wall_middle_m < 0.5 * (4.42e-3 + BLOCK.side_m)
    wall_m = BLOCK.side_m - BLOCK.hole_radius_m(np.radians(101.0))
    assert BLOCK.side_m - BLOCK.wall_middle_m == pytest.approx(wall_m / 2)


def test_nine_convex_pieces_make_up_a_block():
    pieces = BLOCK.convex_pieces()
    assert len(pieces) == 9
    for piece in pieces:
        assert set(piece[:, 2]) == {0.0, BLOCK.height_m}
        top, bottom = piece[piece[:, 2] == 0.0, :2], piece[piece[:, 2] > 0.0, :2]
        np.testing.assert_array_equal(top, bottom)
        radius, angle = np.hypot(*top.T), np.arctan2(top[:, 1], top[:, 0])
        at_hole = np.abs(radius - BLOCK.hole_radius_m(angle)) < 1e-9
        assert (at_hole | (np.abs(radius - BLOCK.outer_radius_m(angle)) < 1e-9)).all() and 2 <= at_hole.sum() <= 3
    volume_m3 = sum(ConvexHull(piece).volume for piece in pieces)
    assert volume_m3 == pytest.approx(AREA_M2 * BLOCK.height_m, rel=0.03), "without gaps, and none overlaps"


def test_the_top_face_is_covered_evenly():
    face = BLOCK.top_face_m(0.2e-3)
    assert len(face) * 0.2e-3**2 == pytest.approx(AREA_M2, rel=0.02) and (face[:, 2] == 0.0).all()
    assert np.abs(face[:, :2].mean(axis=0)).max() < 0.1e-3


def test_the_gap_of_two_blocks_is_measured_whichever_comes_first_and_an_overlap_is_less_than_none():
    here = SE3.from_parts(SO3.axis("z", 0.4), [0.02, 0.01, 0.0]) @ SE3.from_parts(SO3.axis("x", np.pi))
    for gap_m in (1e-3, 0.2e-3, -0.5e-3):
        sides = here @ SE3.from_parts(SO3.axis("z", np.pi), [0.0, 2 * BLOCK.side_m + gap_m, 0.0])
        corner = here @ SE3.from_parts(None, [0.0, BLOCK.side_m + BLOCK.corner_m + gap_m, 0.0])
        found = [BLOCK.gap_m(here, sides), BLOCK.gap_m(here, corner), BLOCK.gap_m(corner, here)]
        if gap_m > 0:
            assert found == [pytest.approx(gap_m, abs=1e-9)] * 3
        else:
            assert max(found) < gap_m + 1e-9
