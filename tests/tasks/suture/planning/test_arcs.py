import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.geometry import TURN
from trocar.tasks.suture.planning.arcs import UNDECIDED, ArcWalks, cut, merged
from trocar.tasks.suture.planning.gaps import Walks

seeds = st.integers(0, 2**32 - 1)
POSITIONS = 720


def random_walks(seed):
    """Return walks over arcs that end on a grid, and the walks of the grid with the positions allowed there."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    even = POSITIONS / count
    shortest = int(max(1, even * rng.uniform(0.5, 1.0)))
    longest = int(min(POSITIONS, np.ceil(even * rng.uniform(1.0, 1.5))))
    ends = np.sort(rng.choice(POSITIONS, 2 * int(rng.integers(1, 5)), replace=False)).reshape(-1, 2)
    if rng.random() < 0.3:
        ends = np.array([[0, POSITIONS]])
    allowed = np.zeros(POSITIONS, dtype=bool)
    for low, high in ends:
        allowed[np.arange(low, high + 1) % POSITIONS] = True
    through = tuple(sorted(rng.choice(np.flatnonzero(allowed), rng.integers(0, 3)).tolist()))
    through = tuple(dict.fromkeys(through))
    step = TURN / POSITIONS
    arcs = tuple((float(low) * step, float(high) * step) for low, high in ends)
    real = ArcWalks(arcs, count, shortest * step, longest * step, tuple(place * step for place in through))
    return real, Walks(POSITIONS, count, shortest, longest, through), allowed


def check(walk, walks):
    assert len(walk) == walks.steps
    around = np.sort(np.mod(walk, TURN))
    gaps = np.diff(around, append=around[0] + TURN)
    assert gaps.min() > walks.min_step_rad - 1e-9 and gaps.max() < walks.max_step_rad + 1e-9
    for place in around:
        assert any(low - 1e-9 <= place + k * TURN <= high + 1e-9 for low, high in walks.arcs for k in (-1, 0, 1))
    for place in walks.through_rad:
        assert np.abs((around - place + np.pi) % TURN - np.pi).min() < 1e-9


@settings(max_examples=300)
@given(seed=seeds)
def test_a_walk_is_found_where_the_grid_has_one_and_is_one(seed):
    real, grid, allowed = random_walks(seed)
    found = real.find(1e-5)
    if len(grid.closing(allowed)):
        assert found is not None
    if isinstance(found, list):
        check(found, real)


def test_most_problems_are_decided():
    found = [random_walks(seed)[0].find(1e-5) for seed in range(150)]
    assert sum(walk == UNDECIDED for walk in found) <= 8
    assert 30 < sum(walk is None for walk in found) < 120


def test_even_gaps_close_only_where_all_arcs_line_up():
    arcs = ((0.1, 0.2), (0.15 + TURN / 3, 0.3 + TURN / 3), (0.0 + 2 * TURN / 3, 0.16 + 2 * TURN / 3))
    walk = ArcWalks(arcs, 3, TURN / 3, TURN / 3).find(1e-6)
    assert isinstance(walk, list)
    assert 0.15 <= np.mod(walk[0], TURN / 3) <= 0.16
    assert ArcWalks((*arcs[:2], (2 * TURN / 3, 0.149 + 2 * TURN / 3)), 3, TURN / 3, TURN / 3).find(1e-6) is None


def test_nothing_closes_over_no_arcs_or_a_place_outside_them():
    assert ArcWalks((), 3, 1.0, 3.0).find(1e-6) is None
    assert ArcWalks(((1.0, 2.0),), 1, 1.0, TURN, through_rad=(3.0,)).find(1e-6) is None
    assert ArcWalks(((1.0, 2.0),), 1, 1.0, TURN, through_rad=(1.5,)).find(1e-6) == [pytest.approx(1.5)]


@given(seed=seeds)
def test_pieces_are_cut_and_merged_as_sets(seed):
    rng = np.random.default_rng(seed)

    def pieces():
        return [tuple(p) for p in np.sort(rng.uniform(0, 10, 2 * rng.integers(0, 5))).reshape(-1, 2)]

    def inside(found, x):
        return np.array([any(low <= value <= high for low, high in found) for value in x], dtype=bool)

    one, other, x = pieces(), pieces(), rng.uniform(0, 10, 200)
    np.testing.assert_array_equal(inside(cut(one, other), x), inside(one, x) & inside(other, x))
    both = merged(sorted(one + other))
    np.testing.assert_array_equal(inside(both, x), inside(one, x) | inside(other, x))
    assert all(a[1] < b[0] for a, b in itertools.pairwise(both))
