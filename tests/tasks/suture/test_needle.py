"""Distances to a bent wire."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.errors import InvalidValue
from trocar.geometry import SE3
from trocar.tasks.suture.needle import NEEDLES, Needle

NEEDLE = Needle()
SEEDS = st.integers(0, 2**32 - 1)


def points_about(rng, count=40):
    return rng.uniform(-0.012, 0.012, (count, 3))


@settings(max_examples=15)
@given(seed=SEEDS)
def test_the_distance_is_that_of_the_nearest_of_many_points_of_the_wire(seed):
    p = points_about(np.random.default_rng(seed))
    wire = NEEDLE.point_m(np.linspace(0.0, NEEDLE.arc_rad, 4000))
    nearest = np.linalg.norm(p[:, None] - wire, axis=2).min(axis=1) - 0.5 * NEEDLE.wire_m
    np.testing.assert_allclose(NEEDLE.distance_m(p), nearest, atol=1e-5)


@settings(max_examples=15)
@given(seed=SEEDS)
def test_the_slopes_are_what_a_small_twist_of_the_needle_does(seed):
    rng = np.random.default_rng(seed)
    p, twist = points_about(rng), rng.standard_normal(6)
    distance, by = NEEDLE.slopes(p)
    step = 1e-6 * twist
    moved = NEEDLE.distance_m(SE3.exp(step).inverse().apply(p))
    back = NEEDLE.distance_m(SE3.exp(-step).inverse().apply(p))
    smooth = np.abs(moved + back - 2.0 * distance) < 1e-9  # not where the nearest end changes
    np.testing.assert_allclose(((moved - back) / 2e-6)[smooth], (by @ twist)[smooth], atol=1e-4)


def test_the_tip_lies_at_minus_y_and_the_tangent_leads_away_from_it():
    np.testing.assert_allclose(NEEDLE.point_m(np.zeros(1))[0], [0.0, -NEEDLE.radius_m, 0.0], atol=1e-15)
    angles = np.linspace(0.0, NEEDLE.arc_rad, 9)
    ahead = (NEEDLE.point_m(angles + 1e-6) - NEEDLE.point_m(angles)) / (1e-6 * NEEDLE.radius_m)
    np.testing.assert_allclose(NEEDLE.tangent(angles), ahead, atol=1e-5)


def test_by_hand():
    """A quarter of a turn, from the tip at -y to the tail at -x."""
    needle = Needle(5e-3, 0.5 * np.pi, 2e-3)
    np.testing.assert_allclose(needle.point_m(np.array([0.5 * np.pi])), [[-5e-3, 0.0, 0.0]], atol=1e-15)
    p = 1e-3 * np.array([[0.0, -9.0, 0.0], [-5.0, 0.0, 3.0], [-5.0, 4.0, 3.0], [3.0, -5.0, 4.0], [-2.4, -1.8, 0.0]])
    np.testing.assert_allclose(needle.behind_tip_rad(p), [0.0, 0.5 * np.pi, 0.5 * np.pi, 0.0, np.arctan2(4.0, 3.0)])
    np.testing.assert_allclose(needle.distance_m(p), 1e-3 * np.array([3.0, 2.0, 4.0, 4.0, 1.0]))
    distance, by = needle.slopes(p[:1])
    np.testing.assert_allclose(distance, [3e-3])
    np.testing.assert_allclose(by, [[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(needle.slopes(p[3:4])[1], [[-0.6, 0.0, -0.8, 4e-3, 0.0, -3e-3]], atol=1e-12)


def test_opposite_the_wire_the_nearer_end_counts():
    """Of a gap of 135 deg: half of it belongs to either end."""
    gap = 2.0 * np.pi - NEEDLE.arc_rad
    for share, end in ((0.45, 0.0), (0.55, NEEDLE.arc_rad)):
        p = NEEDLE.point_m(np.array([-share * gap]))
        assert NEEDLE.behind_tip_rad(p)[0] == pytest.approx(end)


@pytest.mark.parametrize(("what", "value"), [("radius_m", 1e-3), ("arc_rad", 7.0), ("arc_rad", 0.0), ("wire_m", 8e-3)])
def test_a_needle_that_nobody_makes_is_refused(what, value):
    with pytest.raises(InvalidValue, match=f"needle {what.partition('_')[0]} is "):
        Needle(**{what: value})


@pytest.mark.parametrize(
    ("name", "length_mm", "circle"),
    [("RB-1", 17, 1 / 2), ("SH", 26, 1 / 2), ("CT-1", 36, 1 / 2), ("PS-2", 19, 3 / 8), ("UR-6", 26, 5 / 8)],
)
def test_needles_of_the_catalogue_have_the_length_along_the_wire_of_their_package(name, length_mm, circle):
    needle = NEEDLES[name]
    angles = np.linspace(0.0, needle.arc_rad, 20_001)
    points = needle.point_m(angles)
    assert 1e3 * np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(length_mm, rel=1e-6)
    assert np.degrees(needle.arc_rad) == pytest.approx(360 * circle)


def test_an_outline_runs_along_both_sides_of_the_wire():
    needle = Needle()
    assert np.abs(needle.distance_m(needle.outline_m)).max() < 1e-9
    assert {round(float(r), 6) for r in np.linalg.norm(needle.outline_m, axis=1)} == {0.00785, 0.00875}
