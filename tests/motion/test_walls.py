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
