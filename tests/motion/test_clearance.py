from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, SOLIDS, capsules
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import Capsules, capsule_distances_m, segment_distances_m
from trocar.motion import Capsule, HalfSpace, MotionProblem, MovingArm, plan_motion, rest_to_rest, swept_clearance
from trocar.motion import clearance as module
from trocar.motion.bodies import Bodies, greatest_accelerations
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT, transfer

ARM_CASES = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
SEEDS = st.integers(0, 2**32 - 1)
DENSE = 8001


def wild_motion(arm, rng, seconds=0.6, pieces=3, speed=1.0):
    """A spline through random joints with random velocities: faster and more bent than any planner's."""
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1.0, pieces))])
    q = rng.uniform(arm.lower, arm.upper, (pieces + 1, 6))
    q = arm.middle + 0.5 * (q - arm.middle)
    v = speed * rng.normal(size=q.shape) * arm.motion_limits.velocity
    return Trajectory.hermite(seconds * knots / knots[-1], q, v)


def facing(arm, rng):
    """Two bases whose arms work in one place: the second turned about the first's middle tip, and pushed aside."""
    center = MovingArm.resting(arm, arm.middle).ends_m(np.zeros(1))[0, 1, 1]
    turn = SO3.exp(rng.normal(size=3))
    aside = rng.normal(size=3) * 0.02
    return SE3.identity(), SE3.from_parts(turn, center - turn.apply(center) + aside)


def brute_force_m(bodies, times):
    """The least distance at the times, pair by pair."""
    ends = bodies.ends_m(times)
    a, b = bodies.pairs.T
    between = segment_distances_m(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])
    return float((between - bodies.radii_m[a] - bodies.radii_m[b]).min())


@ARM_CASES
@settings(max_examples=12, deadline=None)
@given(seed=SEEDS, speed=st.floats(0.1, 10))
def test_no_point_accelerates_more_than_the_bound(arm, seed, speed):
    rng = np.random.default_rng(seed)
    moving = MovingArm(arm, wild_motion(arm, rng, speed=speed), start_s=0.3, jaw_rad=rng.uniform(0, 1))
    knots = moving.knots_s
    begin, end = knots[:-1], knots[1:]
    bound = greatest_accelerations(moving, begin, end)
    step = 1e-5
    for k in range(len(begin)):
        times = np.linspace(begin[k] + step, end[k] - step, 400)
        points = [moving.ends_m(times + shift) for shift in (-step, 0.0, step)]
        push = np.linalg.norm(points[0] - 2 * points[1] + points[2], axis=-1) / step**2
        assert np.all(push.max(axis=(0, 2)) <= bound[k] * (1 + 1e-4) + 1e-3)


@ARM_CASES
@settings(max_examples=8, deadline=None)
@given(seed=SEEDS, speed=st.floats(0.0, 8.0), enough_mm=st.sampled_from([0.0, 1.0, 20.0, np.inf]))
def test_two_arms_and_obstacles_against_brute_force(arm, seed, speed, enough_mm):
    rng = np.random.default_rng(seed)
    first, second = facing(arm, rng)
    arms = {
        "one": MovingArm(arm, wild_motion(arm, rng, speed=speed), first, rng.uniform(-0.2, 0.2), 0.5),
        "two": MovingArm(arm, wild_motion(arm, rng, speed=speed), second, rng.uniform(-0.2, 0.2), 0.5),
    }
    tip = arms["one"].ends_m(np.array([0.1]))[0, 2, 1]
    obstacles = {
        "ball": Capsule(tip + rng.normal(size=3) * 0.1, radius_m=5e-3),
        "wire": Capsule(tip + rng.normal(size=3) * 0.1, tip + rng.normal(size=3) * 0.1, radius_m=1e-4),
        "wall": HalfSpace(tip + rng.normal(size=3) * 0.3, rng.normal(size=3)),
    }
    enough_m, resolution_m = 1e-3 * enough_mm, 1e-4
    clear = swept_clearance(arms, obstacles=obstacles, enough_m=enough_m, resolution_m=resolution_m)
    bodies = Bodies.of(arms, {}, obstacles)
    assert len(bodies.pairs) == 16 + 2 * 4 * 3
    begin, end = min(one.start_s for one in arms.values()), max(one.end_s for one in arms.values())
    dense_m = brute_force_m(bodies, np.linspace(begin, end, DENSE))
    assert clear.distance_m <= dense_m + 1e-8
    assert clear.distance_m <= clear.sampled_m
    if clear.distance_m < enough_m:
        assert clear.sampled_m - clear.distance_m <= resolution_m + 1e-9
    again_m = brute_force_m(bodies, np.array([clear.time_s]))
    assert again_m <= clear.sampled_m + 1e-8  # nothing else is nearer then; the wall is a ball that rounds to 2 nm
    assert set(clear.between) <= {f"{name} {solid}" for name, solid in product(arms, SOLIDS)} | set(obstacles)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, rate=st.floats(1.0, 300.0), when=st.floats(0.0, 1.0), joint=st.sampled_from([0, 1, 3]))
def test_a_finger_that_whips_past_a_wire_between_two_samples_is_caught(seed, rate, when, joint):
    """Up to 300 rad/s: several turns between the first samples."""
    rng = np.random.default_rng(seed)
    q = PSM.middle + [0, 0, 0.05, 0, 0.8, 0.3]
    speed = np.zeros(6)
    speed[joint] = rate
    motion = Trajectory(np.array([0.0, 0.3]), np.array([speed, q])[:, None])
    moving = MovingArm(PSM, motion)
    tip = moving.ends_m(np.array([0.3 * when]))[0, 2, 1]
    wire = {"wire": Capsule(tip, tip + 1e-3 * rng.normal(size=3), radius_m=1e-5)}
    clear = swept_clearance({"psm1": moving}, obstacles=wire, enough_m=1e-3)
    assert clear.distance_m <= -PSM.instrument.finger_radius_m
    assert "wire" in clear.between and clear.sampled_m < 1e-3


def test_arms_that_move_together_stay_apart_without_ado():
    motion = rest_to_rest(FOUR[0], FOUR[2], PAPER)
    apart = SE3.from_parts(translation_m=[0.0, 0.03, 0.0])
    arms = {"one": MovingArm(PSM, motion), "two": MovingArm(PSM, motion, apart)}
    still = {name: MovingArm.resting(PSM, FOUR[0], arm.T_world_base) for name, arm in arms.items()}
    together, resting = swept_clearance(arms), swept_clearance(still)
    assert 0.0 < resting.distance_m < 0.03
    assert together.distance_m <= together.sampled_m
    assert together.sampled_m - together.distance_m <= 1e-4


def test_who_starts_later_meets_whom():
    """One arm sweeps over the place where the other one arrives later: only together they collide."""
    first = transfer(LEFT, (-0.04, 0.0), (0.02, 0.0))
    second = transfer(RIGHT, (0.05, 0.0), (0.0, 0.0))
    there = plan_motion(MotionProblem({"psm1": first})).trajectory
    back = plan_motion(MotionProblem({"psm1": transfer(LEFT, (0.02, 0.0), (-0.04, 0.0))})).trajectory
    comes = plan_motion(MotionProblem({"psm2": second})).trajectory

    def together(start_s):
        arms = {"psm1": MovingArm(PSM, there.then(back), LEFT), "psm2": MovingArm(PSM, comes, RIGHT, start_s)}
        return swept_clearance(arms, enough_m=1e-3).distance_m

    assert together(0.5) < 1e-3
    assert together(there.duration_s + back.duration_s) >= 1e-3


def test_only_the_span_that_is_asked_for_counts():
    going = MovingArm(PSM, rest_to_rest(FOUR[0], FOUR[1], PAPER))
    high = going.ends_m(np.array([going.end_s]))[0, 2, 1]
    above = {"bar": Capsule(high, radius_m=1e-3)}
    assert swept_clearance({"psm1": going}, obstacles=above).distance_m < 0
    early = swept_clearance({"psm1": going}, obstacles=above, span_s=(-1.0, 0.0))
    assert early.distance_m > 0.01
    assert swept_clearance({"psm1": going}, obstacles=above, span_s=(9.0, 9.0)).distance_m < 0
    with pytest.raises(TrocarError, match=r"from 1\.0 to 0\.0 s; give two finite times in order"):
        swept_clearance({"psm1": going}, obstacles=above, span_s=(1.0, 0.0))
    with pytest.raises(TrocarError, match="cannot be resolved to 0 m"):
        swept_clearance({"psm1": going}, obstacles=above, resolution_m=0)


def test_nothing_to_meet_is_infinitely_far():
    assert swept_clearance({"psm1": MovingArm.resting(PSM, FOUR[0])}).distance_m == np.inf


def test_others_do_not_count_among_themselves():
    there = {name: MovingArm.resting(PSM, FOUR[0], LEFT) for name in ("two", "three")}
    far = MovingArm.resting(PSM, FOUR[0], SE3.from_parts(translation_m=[0, 1.0, 0]))
    assert swept_clearance({"one": far}, others=there).distance_m > 0.5
    assert swept_clearance({"one": far, **there}).distance_m < 0


def test_a_table_under_a_tip_that_goes_down():
    down = MovingArm(PSM, rest_to_rest(FOUR[1], FOUR[0], PAPER))
    low_m = float(down.ends_m(np.array([down.end_s]))[..., 2].min())
    table = {"table": HalfSpace([0.1, 0.0, low_m - 0.01], [0, 0, 1])}
    clear = swept_clearance({"psm1": down}, obstacles=table, resolution_m=1e-6)
    assert clear.distance_m == pytest.approx(0.01 - PSM.instrument.finger_radius_m, abs=4e-6)
    assert clear.time_s == pytest.approx(down.end_s) and clear.between[1] == "table"


def test_the_distance_between_two_poses_is_that_of_their_capsules():
    one, two = MovingArm.resting(PSM, FOUR[0], LEFT), MovingArm.resting(PSM, FOUR[2], RIGHT, jaw_rad=0.7)
    bodies = Bodies.of({"one": one, "two": two}, {}, {})
    apart = capsule_distances_m(capsules(PSM, FOUR[0]).moved(LEFT), capsules(PSM, FOUR[2], 0.7).moved(RIGHT))
    clear = swept_clearance({"one": one, "two": two})
    assert clear.sampled_m == pytest.approx(apart.min(), abs=1e-12)
    a, b = np.unravel_index(np.argmin(apart), apart.shape)
    assert clear.between == (f"one {SOLIDS[a]}", f"two {SOLIDS[b]}")
    assert len(bodies.pairs) == 16


def test_what_is_too_near_need_not_be_known_well():
    """One sample that is too near ends the search: the bound stays one, the least distance is not looked for."""
    first, second = transfer(LEFT, (-0.04, 0.01), (0.03, 0.0)), transfer(RIGHT, (0.04, 0.01), (-0.03, 0.0))
    arms = {
        name: MovingArm(PSM, plan_motion(MotionProblem({name: asked})).trajectory, asked.T_world_base)
        for name, asked in (("psm1", first), ("psm2", second))
    }
    exact = swept_clearance(arms, enough_m=1e-3, resolution_m=1e-5)
    rough = swept_clearance(arms, enough_m=1e-3, resolution_m=1e-5, too_near_m=1e-3)
    assert exact.distance_m < 1e-3 and rough.sampled_m < 1e-3
    assert rough.distance_m <= exact.distance_m <= exact.sampled_m <= rough.sampled_m


def bodies_of(radii, pairs):
    count = len(radii)
    none = Capsules(np.zeros((0, 2, 3)), np.zeros(0))
    return Bodies((), none, tuple("abc"[:count]), np.array(radii), np.array(pairs, dtype=np.intp))


def test_the_first_samples_are_even_and_hold_all_knots():
    def moving(start_s, knots):
        return MovingArm(PSM, Trajectory(np.array(knots), np.tile(FOUR[0], (1, len(knots) - 1, 1))), LEFT, start_s)

    def samples(span=None, *arms):
        return module._first_samples(Bodies.of({str(k): arm for k, arm in enumerate(arms)}, {}, {}), span)

    one, two = moving(0.5, [0.0, 0.1, 0.21]), moving(-0.2, [0.0, 0.3])
    found = samples(None, one, two)
    even = np.linspace(-0.2, 0.71, 24)  # steps of no more than 40 ms
    np.testing.assert_allclose(found, np.unique(np.concatenate([even, [0.1, 0.5, 0.6]])))
    np.testing.assert_allclose(samples((0.0, 0.04), two), [0.0, 0.04])
    np.testing.assert_allclose(samples((0.0, 0.0401), two), [0.0, 0.02005, 0.0401])
    assert len(samples((0.0, 100.0), two)) == 66  # 64 intervals, and one more knot
    assert samples((0.3, 0.3), one).tolist() == [0.3, 0.3]
    merged = samples((0.0, 0.08), moving(0.0, [0.0, 0.04 + 0.5e-9, 0.06]))
    np.testing.assert_allclose(merged, [0.0, 0.04, 0.06, 0.08])
    assert len(samples((0.0, 0.08), moving(0.0, [0.0, 0.04 + 2e-9, 0.06]))) == 5
    for span in ((0.0, np.inf), (np.nan, 1.0)):
        with pytest.raises(TrocarError, match="give two finite times in order"):
            samples(span, one)


def test_stretches_are_eight_intervals_long_and_share_their_ends():
    np.testing.assert_array_equal(module._stretches(17), [np.arange(9), np.arange(8, 17)])
    np.testing.assert_array_equal(module._stretches(18)[-1], [16] + 8 * [17])
    np.testing.assert_array_equal(module._stretches(3), [[0, 1, 2, 2, 2, 2, 2, 2, 2]])
    np.testing.assert_array_equal(module._stretches(1), [np.zeros(9)])


def test_boxes_round_capsules_tell_which_pairs_are_near():
    """A rod, a ball (3, 4) beyond its end and one that is high above both."""
    rod, ball, high = [[0, 0, 0], [1, 0, 0]], [[4, 4, 0]] * 2, [[0.5, 0, 9]] * 2
    ends = np.tile(np.array([rod, ball, high], dtype=float), (3, 1, 1, 1))
    knots = np.array([0.0, 0.2, 0.6])
    bends = np.array([[0.0, 0.0, 0.0], [0.0, 50.0, 0.0]])  # the ball may be 1 m off within .4 s
    bodies = bodies_of([0.1, 0.2, 0.3], [[0, 1], [0, 2], [1, 2]])
    high_m = 9 - 0.4
    ball_m = np.hypot.reduce([3.5 - 0.5 - 1, 4 - 0.5 - 1, 9 - 0.5 - 1])
    for enough_m, kept, apart_m in ((0.0, [0], ball_m), (ball_m + 0.1, [0, 2], high_m), (99.0, [0, 1, 2], np.inf)):
        pair, stretch, apart = module._near(bodies, knots, ends, bends, enough_m)
        assert pair.tolist() == kept and not stretch.any()
        assert apart == pytest.approx(apart_m)
    assert module._near(bodies, knots, ends, 0 * bends, 0.0)[2] == pytest.approx(high_m)  # the ball is further up
    assert module._near(bodies, knots, ends, 0 * bends, np.hypot(2.7, 3.7) + 1e-9)[0].tolist() == [0]


def between(first, second, bend=0.0, seconds=0.5):
    """The distances at two samples, and the bound between, of capsules of radii .1 and .2 that move straight."""
    ends = np.stack([np.array(first, dtype=float), np.array(second, dtype=float)], axis=1)[None]
    bodies = bodies_of([0.1, 0.2], [[0, 1]])
    times = np.array([[1.0, 1.0 + seconds]])
    at, bound = module._measured(bodies, times, ends, np.zeros(1, dtype=int), np.array([[bend]]))
    return at[0], bound[0, 0]


def test_between_two_samples_a_bound_holds_and_is_exact_where_it_can_be():
    rod = [[[-1, 0, 0], [1, 0, 0]]] * 2
    goes = ((0, 2), (0, 3), (0.5, 2))
    still, away, passing = ([[[0, 0, 2]] * 2, [[x, 0, z]] * 2] for x, z in goes)
    assert between(rod, still)[0] == pytest.approx([1.7, 1.7]) and between(rod, still)[1] == pytest.approx(1.7)
    assert between(rod, away)[0] == pytest.approx([1.7, 2.7]) and between(rod, away)[1] == pytest.approx(1.7)
    assert between(away, rod)[1] == pytest.approx(1.7)  # the order of the two does not matter
    assert between(rod, away[::-1])[1] == pytest.approx(1.7)
    assert between(rod, passing)[1] == pytest.approx(1.7)  # along the rod: seen from it nothing is nearer
    assert between(rod, still, bend=3.2)[1] == pytest.approx(1.7 - 3.2 * 0.25 / 8)
    assert between(rod, still, bend=3.2, seconds=1.0)[1] == pytest.approx(1.7 - 3.2 / 8)
    ball, across = [[[0, 0, 0]] * 2] * 2, [[[-1, 0, 1]] * 2, [[1, 0, 1]] * 2]
    at, bound = between(ball, across)
    assert at == pytest.approx([np.sqrt(2) - 0.3] * 2)
    assert bound == pytest.approx(np.sqrt(2) - 1 - 0.3)  # half of the way is lost from the mean; the truth is .7


@pytest.mark.parametrize("seed", range(4))
def test_no_two_capsules_come_nearer_between_samples_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    better = 0
    for _ in range(40):
        first, second = rng.normal(size=(2, 2, 2, 3))
        second[..., 2] += rng.uniform(1, 6)
        share = np.linspace(0, 1, 101)[:, None, None]
        p, q = (one[0] + share * (one[1] - one[0]) for one in (first, second))
        least = segment_distances_m(p[:, 0], p[:, 1], q[:, 0], q[:, 1]).min() - 0.3
        at, bound = between(first, second)
        assert bound <= least + 1e-9 and least <= at.min() + 1e-9
        better += bound > min(at) - 1e-9
    assert better > 3  # often nothing is hidden, and that is known


def test_each_interval_of_each_pair_is_bounded_by_itself():
    rng = np.random.default_rng(7)
    ends = rng.normal(size=(2, 4, 2, 2, 3)) + [0.0, 0.0, 3.0] * np.arange(2)[:, None, None]
    bodies = bodies_of([0.1, 0.2, 0.4], [[0, 1], [1, 2]])
    times, bend = np.array([[0.0, 0.1, 0.3, 0.7], [0.0, 0.2, 0.4, 0.9]]), rng.uniform(1, 9, (2, 3))
    at, bounds = module._measured(bodies, times, ends, np.array([0, 1]), bend)
    for row, part in np.ndindex(2, 3):
        two = slice(part, part + 2)
        alone = module._measured(
            bodies, times[row : row + 1, two], ends[row : row + 1, two], np.array([row]), bend[row : row + 1, [part]]
        )
        np.testing.assert_allclose(alone[0][0], at[row, two])
        np.testing.assert_allclose(alone[1][0, 0], bounds[row, part])
