"""What a motion keeps clear of: obstacles and walls."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.motion import open_box, wall
from trocar.motion.obstacles import stacked

BOX = open_box("box", SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3]), (0.11, 0.07), 0.03, 1.5e-3)


def test_a_wall_reaches_from_its_foot_to_its_top():
    rows = wall("fence", [0, 0, 0.1], [0.05, 0, 0.1], height_m=0.02, radius_m=2e-3)
    heights = [row.start_m[2] for row in rows.values()]
    assert min(heights) == pytest.approx(0.102) and max(heights) == pytest.approx(0.118)
    assert len(wall("low", [0, 0, 0], [1, 0, 0], height_m=4e-3, radius_m=2e-3)) == 1


def test_nothing_2_mm_thick_passes_a_wall():
    """Along all lines that lead from inside to outside, level or slanting."""
    rng = np.random.default_rng(0)
    T = SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3])
    inside = rng.uniform([-0.05, -0.03, 1e-3], [0.05, 0.03, 0.029], (3000, 3))
    angle = rng.uniform(0, 2 * np.pi, 3000)
    outside = inside + 0.2 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    lines = T.apply(np.stack([inside, outside], axis=1))
    thin = Capsules(lines[:, None], np.array([1e-3]))
    assert capsule_distances_m(thin, stacked(BOX)).min(axis=(1, 2)).max() < 0.0


def test_what_is_inside_is_free():
    corners = np.array([[x, y, z] for x in (-0.0549, 0.0549) for y in (-0.0349, 0.0349) for z in (0.0, 0.03)])
    points = SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3]).apply(corners)
    dots = Capsules(np.repeat(points[:, None], 2, axis=1), np.zeros(8))
    assert capsule_distances_m(dots, stacked(BOX)).min() > 0.0


def test_a_wall_thicker_than_high_is_refused():
    with pytest.raises(TrocarError, match=r"cannot be 0\.003 m high and 0\.004 m thick"):
        wall("slab", [0, 0, 0], [1, 0, 0], height_m=3e-3, radius_m=2e-3)


ROWS = [(1, 0.0, 1), (3, 0.0, 3), (3, 1e-6, 4), (3, -1e-6, 3), (2, 0.0, 2)]


@pytest.mark.parametrize(("rows", "more_m", "found"), ROWS)
def test_a_wall_has_no_more_rows_than_its_gaps_ask_for(rows, more_m, found):
    """Rows 4 mm thick, 1.5 mm apart at most."""
    height_m = 4e-3 + (rows - 1) * 5.5e-3 + more_m
    made = wall("fence", [0, 0, 0.1], [0.05, 0.01, 0.1], height_m=height_m, radius_m=2e-3)
    assert list(made) == [f"fence {k}" for k in range(found)]
    heights = np.array([row.start_m[2] for row in made.values()]) - 0.1
    np.testing.assert_allclose(heights, np.linspace(2e-3, height_m - 2e-3, found), atol=1e-12)
    for row in made.values():
        np.testing.assert_allclose(row.end_m - row.start_m, [0.05, 0.01, 0.0])
        assert row.radius_m == 2e-3


def test_a_box_is_closed_and_as_wide_inside_as_is_asked():
    box = open_box("box", SE3.from_parts(translation_m=[0.1, 0.2, 0.3]), (0.11, 0.07), 0.02, 2e-3)
    low = [box[f"box {k} 0"] for k in range(4)]
    for one, following in zip(low, [*low[1:], low[0]], strict=True):
        np.testing.assert_allclose(one.end_m, following.start_m)
    starts = np.array([one.start_m for one in low]) - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(np.abs(starts), np.tile([0.057, 0.037, 2e-3], (4, 1)))
    assert len(np.unique(starts.round(9), axis=0)) == 4
    assert len(box) == 16


@pytest.mark.parametrize(
    ("height_m", "radius_m", "made"), [(10.0, 0.5, True), (10.1, 0.5, False), (1.0, 0.0, False), (1.0, 0.5, True)]
)
def test_walls_are_thick_and_no_higher_than_ten_metres(height_m, radius_m, made):
    if made:
        assert wall("fence", [0, 0, 0], [1, 0, 0], height_m, radius_m)
    else:
        with pytest.raises(TrocarError, match="a wall cannot be"):
            wall("fence", [0, 0, 0], [1, 0, 0], height_m, radius_m)


def test_a_box_without_room_is_refused():
    with pytest.raises(TrocarError, match="give two lengths above 0"):
        open_box("tray", SE3.identity(), (0.1, 0.0), 0.02, 0.002)
    with pytest.raises(TrocarError, match="give two lengths above 0"):
        open_box("tray", SE3.identity(), (0.0, 0.1), 0.02, 0.002)
