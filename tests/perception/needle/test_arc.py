"""Distances to a bent wire."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.perception.needle import NeedleArc

ARC = NeedleArc(8.3e-3, np.radians(225.0), 0.9e-3)
SEEDS = st.integers(0, 2**32 - 1)


def points_about(rng, count=40):
    return rng.uniform(-0.012, 0.012, (count, 3))


@given(seed=SEEDS)
def test_the_distance_is_that_of_the_nearest_of_many_points_of_the_wire(seed):
    p = points_about(np.random.default_rng(seed))
    wire = ARC.point_m(np.linspace(0.0, ARC.arc_rad, 4000))
    nearest = np.linalg.norm(p[:, None] - wire, axis=2).min(axis=1) - 0.5 * ARC.wire_m
    np.testing.assert_allclose(ARC.distance_m(p), nearest, atol=1e-5)


@given(seed=SEEDS)
def test_the_slopes_are_what_a_small_twist_of_the_needle_does(seed):
    rng = np.random.default_rng(seed)
    p, twist = points_about(rng), rng.standard_normal(6)
    distance, by = ARC.slopes(p)
    step = 1e-6 * twist
    moved = ARC.distance_m(SE3.exp(step).inverse().apply(p))
    back = ARC.distance_m(SE3.exp(-step).inverse().apply(p))
    smooth = np.abs(moved + back - 2.0 * distance) < 1e-9  # not where the nearest end changes
    np.testing.assert_allclose(((moved - back) / 2e-6)[smooth], (by @ twist)[smooth], atol=1e-4)


def test_the_tip_lies_at_minus_y_and_the_tangent_leads_away_from_it():
    np.testing.assert_allclose(ARC.point_m(np.zeros(1))[0], [0.0, -ARC.radius_m, 0.0], atol=1e-15)
    angles = np.linspace(0.0, ARC.arc_rad, 9)
    ahead = (ARC.point_m(angles + 1e-6) - ARC.point_m(angles)) / (1e-6 * ARC.radius_m)
    np.testing.assert_allclose(ARC.tangent(angles), ahead, atol=1e-5)


def test_a_needle_without_a_shape_is_refused():
    with pytest.raises(TrocarError, match="has no shape"):
        NeedleArc(8.3e-3, 7.0, 0.9e-3)
