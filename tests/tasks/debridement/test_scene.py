"""Random scenes: fragments of the right size, apart from each other, in the region."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.stats import kstest

from trocar.geometry import SE3, SO3
from trocar.perception.color import RED_FOAM, to_hsv
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.scene import (
    CLING_N,
    CLING_SHARE,
    CORNERS,
    GAP_M,
    HALF_M,
    HEIGHT_M,
    LENGTH_M,
    PROUD_M,
    SHIFT_M,
    TURN_RAD,
    WIDTH_M,
    lay_out,
)

TABLE = SE3.from_parts(translation_m=[-0.0745, 0.0, -0.162])
RECEPTACLE = SE3.from_parts(SO3.axis("z", 0.1), [-0.0745, 0.004, -0.162])


@pytest.fixture(scope="module")
def scenes():
    return [lay_out(TABLE, RECEPTACLE, Workspace(), np.random.default_rng(seed)) for seed in range(60)]


@pytest.fixture(scope="module")
def fragments(scenes):
    return [fragment for scene in scenes for fragment in scene.fragments]


def corners_in_world(fragment):
    return fragment.T_world_fragment.apply(fragment.vertices_m)


def test_fragments_have_the_extents_of_the_workspace(fragments):
    sizes = np.array([np.ptp(fragment.vertices_m, axis=0) for fragment in fragments])
    for axis, (low, high) in enumerate((LENGTH_M, WIDTH_M, HEIGHT_M)):
        assert (sizes[:, axis] > low - 1e-9).all() and (sizes[:, axis] < high + 1e-9).all()


def test_fragments_are_convex_and_their_origin_is_their_centre_of_mass(fragments):
    for fragment in fragments[:40]:
        hull = ConvexHull(fragment.vertices_m)
        assert 6 <= len(hull.vertices) == len(fragment.vertices_m) <= CORNERS
        rng = np.random.default_rng(0)
        low, high = fragment.vertices_m.min(0), fragment.vertices_m.max(0)
        points = rng.uniform(low, high, (20_000, 3))
        inside = (hull.equations[:, :3] @ points.T + hull.equations[:, 3:] < 0).all(axis=0)
        assert np.abs(points[inside].mean(axis=0)).max() < 0.15e-3


def test_fragments_weigh_what_the_facts_guess(fragments):
    grams = [1e3 * ConvexHull(f.vertices_m).volume * f.density_kg_m3 for f in fragments]
    low, middle, high = np.percentile(grams, [5, 50, 95])
    assert 0.05 < low < middle < high < 0.2


def test_fragments_lie_on_the_table_in_the_region_and_do_not_touch(scenes):
    low, high = np.array(Workspace().region_m)
    for scene in scenes:
        assert len(scene.fragments) == Workspace().fragments
        for fragment in scene.fragments:
            place = fragment.T_world_fragment.translation_m
            assert (place[:2] >= low).all() and (place[:2] <= high).all()
            assert 0 < corners_in_world(fragment)[:, 2].min() - TABLE.translation_m[2] < 0.5e-3
        outlines = [corners_in_world(fragment)[:, :2] for fragment in scene.fragments]
        for k, one in enumerate(outlines):
            for other in outlines[:k]:
                nearest = np.linalg.norm(one[:, None] - other, axis=-1).min()
                assert nearest > GAP_M


def test_fragments_lie_everywhere_alike_and_turned_by_any_angle(fragments):
    low, high = np.array(Workspace().region_m)
    places = np.array([f.T_world_fragment.translation_m[:2] for f in fragments])
    for axis in (0, 1):
        assert kstest((places[:, axis] - low[axis]) / (high - low)[axis], "uniform").pvalue > 1e-3
    x = np.array([f.T_world_fragment.rotation.matrix[:, 0] for f in fragments])
    assert kstest(np.arctan2(x[:, 1], x[:, 0]) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


def test_some_fragments_are_charged(fragments):
    cling = np.array([fragment.cling_n for fragment in fragments])
    charged = cling > 0
    assert abs(charged.mean() - CLING_SHARE) < 0.07
    assert cling[charged].min() >= CLING_N[0] and cling.max() <= CLING_N[1]


def test_the_receptacle_stands_a_little_beside_its_place(scenes):
    off = np.array([(RECEPTACLE.inverse() @ scene.T_world_receptacle).matrix for scene in scenes])
    assert 0.5e-3 < np.abs(off[:, :2, 3]).max() <= SHIFT_M and (off[:, 2, 3] == 0).all()
    assert 0 < np.abs(np.arcsin(off[:, 1, 0])).max() <= TURN_RAD + 1e-12


@pytest.mark.parametrize("count", [1, 12])
def test_as_many_fragments_as_are_asked_for(count):
    scene = lay_out(TABLE, RECEPTACLE, Workspace(fragments=count), np.random.default_rng(0))
    assert len(scene.fragments) == count


# Tissue.


def test_a_plain_surface_has_no_tissue_and_the_same_fragments():
    plain, tissue = (
        lay_out(TABLE, RECEPTACLE, Workspace(), np.random.default_rng(5), backdrop) for backdrop in ("plain", "tissue")
    )
    assert plain.tissue == () and len(tissue.tissue) > 20
    for one, other in zip(plain.fragments, tissue.fragments, strict=True):
        assert np.array_equal(corners_in_world(one), corners_in_world(other))


def test_tissue_is_flat_and_none_is_as_red_as_a_fragment():
    scene = lay_out(TABLE, RECEPTACLE, Workspace(), np.random.default_rng(5), "tissue")
    for patch in scene.tissue:
        corners = patch.T_world_patch.apply(patch.corners_m()) - TABLE.translation_m
        assert corners[:, 2].min() > -1e-9 and corners[:, 2].max() <= PROUD_M + 1e-9
        assert (np.abs(patch.T_world_patch.translation_m - TABLE.translation_m)[:2] <= HALF_M).all()
    painted = np.array([[[*patch.color] for patch in scene.tissue]]) * 255
    assert not RED_FOAM.mask(to_hsv(painted.astype(np.uint8))).any()
