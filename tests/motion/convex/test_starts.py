import numpy as np
import pytest

from ravens import asked, swapping
from trocar.arms import wrist_depth_m
from trocar.motion.convex.scene import Scene
from trocar.motion.convex.search import Search
from trocar.motion.convex.starts import FEW, MORE, plain_path

TWO = swapping(0.03)
THREE = np.stack([TWO[:, 0], TWO.mean(axis=1) + 0.02, TWO[:, 1]], axis=1)


def search_for(waypoints, count=2, **more):
    problem = asked(waypoints, **more)
    arms = dict(list(problem.arms.items())[:count])
    problem = type(problem)(arms, obstacles=problem.obstacles, min_distance_m=problem.min_distance_m, **more)
    return Search(problem, Scene.of(problem))


BOTH, ONE, PASSING = search_for(TWO), search_for(TWO, count=1), search_for(THREE)


def middle(control):
    return BOTH.curve.path(control)(np.array([0.5]))[0]


def test_the_plain_path_of_two_waypoints_is_a_straight_line():
    start, end = (np.concatenate(TWO[:, i]) for i in (0, 1))
    np.testing.assert_allclose(BOTH.starts.plain, BOTH.curve.line(start, end), atol=1e-12)


def test_the_plain_path_passes_all_waypoints_with_the_least_energy():
    search = PASSING
    plain, energy = search.starts.plain, search.programme.energy
    for k, shares in enumerate(search.passing):
        passed = search.curve.path(plain)(shares)[:, 6 * k : 6 * k + 6]
        np.testing.assert_allclose(passed, THREE[k], atol=1e-9)
    rng = np.random.default_rng(0)
    for k in range(2):
        held = np.vstack([search.programme.held[k], np.eye(search.curve.controls)[[0, -1]]])
        free = np.eye(search.curve.controls) - np.linalg.pinv(held) @ held
        for size in (1e-3, 0.1):
            aside = np.zeros_like(plain)
            aside[:, 6 * k : 6 * k + 6] = size * free @ rng.normal(size=(search.curve.controls, 6))
            assert energy(plain + aside) > energy(plain) and energy(plain - aside) > energy(plain)
    alone = plain_path(search.arms[1:], search.curve, search.programme.held[1:])
    np.testing.assert_allclose(alone, plain[:, 6:])


@pytest.mark.parametrize("k", [0, 1])
def test_an_arm_swings_aside_and_pulls_back_in_the_middle_of_its_way(k):
    starts, places = BOTH.starts, BOTH.curve.places
    change = starts._aside({k: (0.3, -0.2, 0.05)}) - starts.plain
    np.testing.assert_allclose(change[[0, -1]], 0, atol=1e-9)
    assert not np.delete(change, [6 * k, 6 * k + 1, 6 * k + 2], axis=1).any()
    most = change[len(places) // 2 - 1 : len(places) // 2 + 1].mean(axis=0)
    np.testing.assert_allclose(most[6 * k : 6 * k + 2], [0.3, -0.2], rtol=0.02)
    assert np.all(np.diff(change[: len(places) // 2, 6 * k]) > 0)  # further and further up to there
    np.testing.assert_allclose(change, change[::-1], atol=1e-9)
    early = np.interp(0.25, places, change[:, 6 * k])
    assert 0.7 * 0.3 < early < 0.85 * 0.3  # broader than a sine
    aside, plain = (middle(control)[6 * k : 6 * k + 6] for control in (starts.plain + change, starts.plain))
    depths_m = [abs(wrist_depth_m(BOTH.arms[k].model, q)) for q in (aside, plain)]
    assert depths_m[0] < depths_m[1] - 0.04


@pytest.mark.parametrize("first", [0, 1])
def test_one_arm_arrives_before_the_other_sets_out(first):
    control = BOTH.starts._one_after_the_other(first, {})
    half = middle(control).reshape(2, 6)
    np.testing.assert_allclose(half[first], TWO[first, 1], atol=0.15 * np.abs(TWO[first, 1] - TWO[first, 0]).max())
    other = 1 - first
    np.testing.assert_allclose(half[other], TWO[other, 0], atol=0.15 * np.abs(TWO[other, 1] - TWO[other, 0]).max())
    np.testing.assert_allclose(control[[0, -1]], BOTH.starts.plain[[0, -1]], atol=1e-9)
    quarter = BOTH.curve.path(control)(np.array([0.25]))[0].reshape(2, 6)[first]
    np.testing.assert_allclose(quarter, TWO[first].mean(axis=0), atol=0.02)
    aside = BOTH.starts._one_after_the_other(first, {first: (0.3, 0.0, 0.0)})
    assert BOTH.curve.path(aside)(np.array([0.25]))[0][6 * first] > quarter[0] + 0.2


def test_starts_lead_round_by_one_arm_by_both_and_one_after_the_other():
    for search, few, many in ((ONE, 6, [26]), (BOTH, 20, [52, 52, 52, 81])):
        batches = [search.starts.few(), *search.starts.many()]
        assert [len(batch) for batch in batches] == [few, *many]
        for batch in batches:
            assert len(np.unique(batch.round(9), axis=0)) > 0.6 * len(batch)
            np.testing.assert_allclose(batch[:, [0, -1]], np.tile(search.starts.plain[[0, -1]], (len(batch), 1, 1)))
    few = BOTH.starts.few() - BOTH.starts.plain
    moved = np.abs(few).max(axis=1) > 1e-9
    assert (moved[:, :6].any(axis=1) & moved[:, 6:].any(axis=1)).sum() >= 2
    for columns in (slice(0, 6), slice(6, 12)):
        alone = moved[:, columns].any(axis=1) & ~np.delete(moved, np.r_[columns], axis=1).any(axis=1)
        assert alone.sum() >= 6
        for joint in (0, 1):  # to either side
            swing = few[alone][:, few.shape[1] // 2, columns][:, joint]
            assert swing.max() > 0.15 and swing.min() < -0.15


def test_starts_stay_within_the_ranges_and_go_through_the_waypoints():
    for slack in (0.0, 0.01):
        starts = search_for(TWO, range_slack=slack).starts
        wild = starts.plain + np.array([9.0, -9.0])[:, None, None] * np.ones_like(starts.plain)
        kept = starts._kept(list(wild))
        for k, arm in enumerate(starts.arms):
            spare = slack * (arm.model.upper - arm.model.lower)
            part = kept[:, 1:-1, 6 * k : 6 * k + 6]
            np.testing.assert_allclose(part[0], np.tile(arm.model.upper + spare, (len(part[0]), 1)))
            np.testing.assert_allclose(part[1], np.tile(arm.model.lower - spare, (len(part[1]), 1)))
        np.testing.assert_array_equal(kept[:, [0, -1]], np.tile(starts.plain[[0, -1]], (2, 1, 1)))
    search = PASSING
    for batch in (search.starts.few(), next(search.starts.many())):
        for control in batch[::7]:
            for k, shares in enumerate(search.passing):
                passed = search.curve.path(control)(shares)[:, 6 * k : 6 * k + 6]
                np.testing.assert_allclose(passed, THREE[k], atol=1e-9)


def test_ways_aside_are_as_many_to_one_side_as_to_the_other_and_none_is_wild():
    assert len(set(FEW)) == 6 and len(set(MORE)) == 26
    for ways in (FEW, MORE):
        assert all({(-a, b, c), (a, -b, c), (-a, -b, c)} <= set(ways) for a, b, c in ways)
        assert all(abs(a) < 0.5 and abs(b) < 0.5 and 0 <= c < 0.1 for a, b, c in ways)
    assert all(np.count_nonzero(way) == 1 for way in FEW)  # one thing at a time is tried first
    assert all(a == b == 0 for a, b, _ in FEW[:2])  # pulling back before all
    assert max(map(max, MORE)) == 2 * max(map(max, FEW))
