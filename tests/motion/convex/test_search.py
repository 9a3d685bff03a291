"""Where to start and how to go on: the search over convex programmes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ravens import asked, down, joints, least_m, swapping
from trocar.arms import MotionLimits, fk, wrist_depth_m
from trocar.geometry import SE3
from trocar.motion import ArmMotion, Capsule, Facing, MotionProblem, MovingArm
from trocar.motion.convex import search as module
from trocar.motion.convex.path_program import Rows
from trocar.motion.convex.scene import Scene
from trocar.motion.convex.search import FEW, MORE, PATIENT, QUICK, Effort, Search, Sight, passing_shares, plain_path
from trocar.trajectory import Trajectory
from waypoints import PSM

TWO = swapping(0.03)
THREE = np.stack([TWO[:, 0], TWO.mean(axis=1) + 0.02, TWO[:, 1]], axis=1)


def search_for(problem):
    return Search(problem, Scene.of(problem))


TRADED = asked(TWO)
BOTH, PASSING = search_for(TRADED), search_for(asked(THREE))
ONE = search_for(replace(TRADED, arms={"left": TRADED.arms["left"]}))


def middle(control):
    return BOTH.curve.path(control)(np.array([0.5]))[0]


def test_the_plain_path_passes_all_waypoints_with_the_least_energy():
    search = PASSING
    plain, energy = search.starts.plain, search.program.energy
    for k, shares in enumerate(search.passing):
        passed = search.curve.path(plain)(shares)[:, 6 * k : 6 * k + 6]
        np.testing.assert_allclose(passed, THREE[k], atol=1e-9)
    rng = np.random.default_rng(0)
    for k in range(2):
        held = np.vstack([search.program.held[k], np.eye(search.curve.controls)[[0, -1]]])
        free = np.eye(search.curve.controls) - np.linalg.pinv(held) @ held
        for size in (1e-3, 0.1):
            aside = np.zeros_like(plain)
            aside[:, 6 * k : 6 * k + 6] = size * free @ rng.normal(size=(search.curve.controls, 6))
            assert energy(plain + aside) > energy(plain) and energy(plain - aside) > energy(plain)
    alone = plain_path(search.arms[1:], search.curve, search.program.held[1:])
    np.testing.assert_allclose(alone, plain[:, 6:])


@pytest.mark.parametrize("ways", [FEW, MORE])
def test_detours_swing_to_either_side_alike_and_pull_back_never_forth(ways):
    assert len(set(ways)) == len(ways) and (0, 0, 0) not in ways
    assert {(-first, -second, back_m) for first, second, back_m in ways} == set(ways)
    assert all(max(abs(first), abs(second)) <= 0.4 and 0.0 <= back_m <= 0.08 for first, second, back_m in ways)
    assert ways is MORE or all(np.count_nonzero(way) == 1 for way in ways), "the first do one thing each"


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
        starts = search_for(asked(TWO, range_slack=slack)).starts
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


LEFT = [joints("left", down(tip)) for tip in ([-0.03, 0.02, -0.10], [-0.045, 0.01, -0.11], [-0.06, 0.0, -0.12])]
RIGHT = [joints("right", down(tip)) for tip in ([-0.12, -0.03, -0.11], [-0.12, -0.03, -0.12])]
APART, CROSSING = asked([LEFT[::2], RIGHT]), asked(swapping(0.01))


def test_waypoints_are_passed_when_their_joints_need_it():
    """Roots of the greatest distance over acceleration: 2 s, 1 s, 1 s."""
    limits = MotionLimits(np.ones(6), np.array([0.1, 0.2, 0.1, 1.0, 1.0, 1.0]))
    steps = np.array([[0, 0, 0, 0, 0, 0], [0.4, 0.4, 0, 0, 0, 0], [0.3, 0.6, 0, 0, 0, 0], [0.3, 0.6, 0.1, 0, 0.2, 0]])
    arm = ArmMotion(PSM, PSM.middle + steps, limits)
    np.testing.assert_allclose(passing_shares(arm), [0.0, 0.5, 0.75, 1.0])


def test_a_path_costs_its_energy_and_what_it_breaks():
    rows = Rows(np.array([0.2, -0.03, -0.01]), np.zeros((3, 1)), np.zeros((3, 1)))
    sight = Sight(np.zeros((4, 1)), rows, 5.0)
    assert sight.worst_m == 0.03 and sight.merit(100.0) == pytest.approx(9.0)
    assert Sight(np.zeros((4, 1)), Rows(rows.room[:1], rows.slope[:1], rows.basis[:1]), 5.0).worst_m == 0.0


def test_joints_weigh_by_the_acceleration_that_they_may_have():
    limits = MotionLimits(np.ones(6), np.array([2.0, 1.0, 0.5, 4.0, 2.0, 2.0]))
    arm = ArmMotion(PSM, PSM.middle + np.outer([0, 1, 2], [0.1] + [0.0] * 5), limits)
    search = search_for(MotionProblem({"it": arm}))
    np.testing.assert_allclose(search.program.weights, [1, 4, 16, 0.25, 1, 1])
    assert search.curve.pieces == 13 and len(search.shares) == 13 * 4 - 1  # a waypoint on the way has pieces of its own
    assert search_for(APART).curve.pieces == 9


def test_what_is_seen_of_a_path_is_what_its_rows_break():
    search = search_for(CROSSING)
    sight = search.seen(search.starts.plain)
    assert sight.energy == pytest.approx(search.program.energy(search.starts.plain))
    assert sight.broken_m == pytest.approx(-sight.rows.room[sight.rows.room < 0].sum()) and sight.broken_m > 0.01
    assert search_for(APART).seen(search_for(APART).starts.plain).broken_m == 0.0
    other = search_for(APART)
    assert other.seen(other.starts.plain).broken_m == 0.0
    control = other.starts.plain.copy()
    control[5, 2] = APART.arms["left"].model.lower[2] - 0.01
    out = other.seen(control)
    assert out.rows.room.min() <= -0.1 * 0.01 and out.broken_m > 1e-3  # out of a range: that counts too


def test_a_step_goes_no_further_than_it_is_trusted_and_tells_what_it_promised():
    search = search_for(CROSSING)
    sight = search.seen(search.starts.plain)
    for price, damping in ((300.0, 0.0), (3e4, 0.0), (300.0, 50.0)):
        after, hoped = search._step(sight, price, damping)
        change = after.control - sight.control
        assert np.abs(change[:, [0, 1, 3, 4, 5, 6]]).max() <= 0.35 + 1e-12
        assert np.abs(change[:, [2, 8]]).max() <= 0.05 + 1e-12
        left = sight.rows.after(change)
        promised = search.program.energy(after.control) - price * left[left < 0].sum()
        assert hoped == pytest.approx(sight.merit(price) - promised)
        assert hoped > 0 and after.broken_m < sight.broken_m
    far = search.seen(sight.control)
    far.rows.room[:] = -1.0  # far from what is asked: the first step is as long as may be
    longest = search._step(far, 3e4, 0.0)[0].control - sight.control
    assert (np.abs(longest) / search.trust).max() == pytest.approx(1.0)


def test_starts_are_followed_from_the_quick_ones_to_the_patient_ones():
    search = search_for(CROSSING)
    batches = [(len(batch), effort) for batch, effort in search._batches()]
    few, many = len(search.starts.few()), [len(batch) for batch in search.starts.many()]
    sizes = [1, few, 1, *many, few, *many]
    quick = [True, True, False, *(True for _ in many), False, *(False for _ in many)]
    assert batches == [(n, QUICK if fast else PATIENT) for n, fast in zip(sizes, quick, strict=True)]
    assert len(PATIENT.prices) > len(QUICK.prices) and PATIENT.steps > QUICK.steps
    np.testing.assert_allclose(PATIENT.prices, [300.0, 3e3, 3e4])


def test_the_best_starts_come_first_and_what_is_far_from_all_is_no_longer_looked_at():
    search = search_for(CROSSING)
    plain = search.starts.plain
    few = sorted(search.starts.few(), key=lambda c: search.seen(c).merit(300.0))
    clear, further = few[0], next(c for c in few if search.seen(c).energy > 2 * search.seen(few[0]).energy)
    assert search.seen(clear).broken_m == 0.0 and search.seen(plain).broken_m > 0.1
    ordered = search._in_order(np.stack([further, plain, clear]))
    np.testing.assert_array_equal(ordered, [clear, further, plain])
    search = search_for(APART)
    plain, bumps = search.starts.plain, np.sin(np.pi * search.curve.places)[:, None]
    many = plain + 0.01 * np.random.default_rng(0).normal(size=(30, *plain.shape)) * bumps
    assert len(search._in_order(many)) == 12
    q = np.concatenate([search.curve.path(control)(search.shares[::2]) for control in many])
    near = search.scene.everything().distances(q, np.zeros(1)).distance_m.min(axis=0)
    assert len(search.scene.pairs) == (near < 1e-3 + 0.04).sum() < len(near)


def test_a_path_of_no_more_waypoints_is_a_straight_line():
    search = search_for(APART)
    path = search._plain_path()
    assert len(path.coefficients) == 2
    np.testing.assert_allclose(path(1.0)[:6], APART.arms["left"].waypoints[1], atol=1e-12)
    np.testing.assert_allclose(path(0.0)[6:], APART.arms["right"].waypoints[0], atol=1e-12)
    three = search_for(asked([LEFT, RIGHT]))
    bent = three._plain_path()
    assert len(bent.coefficients) == 4
    np.testing.assert_allclose(bent(three.passing[0])[:, :6], LEFT, atol=1e-9)


def test_a_path_out_of_its_range_or_turned_aside_is_not_certified():
    search = search_for(APART)
    coefficients = search._plain_path().coefficients.copy()
    coefficients[1, 0, 2] = APART.arms["left"].model.upper[2] + 0.1
    beyond = Trajectory(np.array([0.0, 1.0]), coefficients)
    assert search.certified(beyond) is None and search.margin_m == module.MARGIN_M
    aside = replace(APART.arms["left"], facing=Facing([0.0, 1.0, 0.0], [-0.05, 0.5, -0.12], 1e-3))
    turned = search_for(replace(APART, arms=APART.arms | {"left": aside}))
    margins = []
    for _ in range(6):
        assert turned.certified(turned._plain_path()) is None
        margins.append(turned.margin_rad)
    np.testing.assert_allclose(margins, [0.02, 0.04, 0.08, 0.1, 0.1, 0.1])


@pytest.mark.parametrize("missing_m", [1e-3, 2.9e-3, 3.1e-3])
def test_a_path_that_is_a_little_too_near_is_looked_at_more_closely_there(missing_m):
    arm = APART.arms["left"]
    half = arm.waypoints.mean(axis=0)
    tip = arm.T_world_base @ fk(arm.model, half)
    alone = replace(APART, arms={"left": arm})
    under = {"ball": Capsule(tip.translation_m + [0, 0, -0.03], radius_m=1e-3)}
    path = search_for(alone)._plain_path()
    apart_m = least_m(replace(alone, obstacles=under), {"left": path}, 1.0, 4001)
    problem = replace(alone, obstacles=under, min_distance_m=apart_m + missing_m)
    search = search_for(problem)
    before = search.shares
    assert search.certified(path) is None
    assert search.passes_through == (missing_m > 3e-3)
    if not search.passes_through:
        assert search.margin_m == pytest.approx(min(5e-4 + missing_m / 2, 2e-3), abs=2e-6)
        new = np.setdiff1d(search.shares, before)
        q = path(new)
        near = Scene.of(problem).distances(q, np.zeros(1)).distance_m.min()
        assert len(new) == 1 and near == pytest.approx(apart_m, abs=1e-5)
        np.testing.assert_allclose(search.basis @ search.curve.places, search.shares, atol=1e-12)
        for _ in range(3):
            search._look_closer(None, 1.0, 1e-3)
        assert search.margin_m == 2e-3 and search.shares[-1] == 1 - 1e-3
        search._look_closer(None, 0.0, 0.0)
        assert search.shares[0] == 1e-3
    for more_m, certified in ((-1e-6, True), (3e-6, False)):
        nearly = search_for(replace(problem, min_distance_m=apart_m + more_m))
        assert (nearly.certified(path) is not None) == certified


def passing_by(start_s):
    """The left arm's plain way, and a right one that is in its way for a second."""
    arm, station = CROSSING.arms["left"], CROSSING.arms["right"]
    half = arm.T_world_base @ fk(arm.model, arm.waypoints.mean(axis=0))
    hit, away = joints("right", half), joints("right", down([-0.15, 0.0, -0.09]))
    motion = Trajectory.hermite([0.0, 1.0], np.array([hit, away]), np.zeros((2, 6)))
    other = MovingArm(station.model, motion, station.T_world_base, start_s)
    return replace(CROSSING, arms={"left": arm}, others={"other": other})


def test_where_another_arm_moves_a_motion_waits_for_it_no_longer_than_needed():
    seconds = []
    for start_s in (-1.0, 0.5, 4.0):
        problem = passing_by(start_s)
        search = search_for(problem)
        timing = search.certified(search._plain_path())
        times = np.linspace(0.0, timing.motion.duration_s, 500)
        apart_m = Scene.of(problem).distances(timing.motion(times), times).distance_m
        assert apart_m.min() > 1e-3 - 1e-6
        waited_s = timing.motion.times_s[1] if timing.shares[1] == 0.0 else 0.0
        assert np.isclose(waited_s, np.array([0.0, 0.25, 0.5, 0.75, 1.0]) * (start_s + 1.0)).any()
        sooner = search._timed(search._plain_path()).later(max(0.0, waited_s - 0.25 * (start_s + 1.0))).motion
        if waited_s:
            times = np.linspace(0.0, sooner.duration_s, 500)
            assert Scene.of(problem).distances(sooner(times), times).distance_m.min() < 1e-3
        seconds.append(timing.motion.duration_s)
    assert seconds[0] < seconds[1] < seconds[2]


def test_margins_are_kept_beside_the_distances_that_are_asked():
    search = search_for(CROSSING)
    rooms = []
    for margin_m in (0.0, 0.01):
        search.margin_m = margin_m
        rooms.append(search.seen(search.starts.plain).rows.room.min())
    assert rooms[1] == pytest.approx(rooms[0] - 0.01)
    left = APART.arms["left"]
    facing = Facing([0.0, 1.0, 0.0], [-0.05, 0.5, -0.12], 3.0)
    angles = facing.angle_rad(left.T_world_base @ fk(left.model, left.waypoints))
    limited = replace(left, facing=replace(facing, max_rad=float(angles.max()) + 0.1))
    turned = search_for(replace(APART, arms=APART.arms | {"left": limited}))
    for margin_rad, breaks in ((0.05, False), (0.2, True)):
        turned.margin_rad = margin_rad
        assert (turned.seen(turned.starts.plain).broken_m > 0) == breaks


def test_a_path_is_certified_four_times_as_finely_as_it_is_planned(monkeypatch):
    search, looked_at = search_for(APART), []
    monkeypatch.setattr(module, "in_range", lambda arms, q, slack: looked_at.append(q))
    path = search._plain_path()
    assert search.certified(path) is None
    np.testing.assert_allclose(looked_at[0], path(np.linspace(0, 1, 145)))


@pytest.mark.parametrize("enough", [0, 2, 4, 9])
def test_it_waits_by_quarters_of_the_time_until_the_last_other_arm_rests(monkeypatch, enough):
    problem = passing_by(3.0)
    other, search, waits = problem.others["other"], search_for(problem), []
    early = replace(other, start_s=0.5, T_world_base=SE3.from_parts(translation_m=[1.0, 0.0, 0.0]))
    search.problem = replace(problem, others={"early": early, "late": other})

    def clear(self, motion, timing):
        waits.append(motion.duration_s)
        return len(waits) > enough

    monkeypatch.setattr(Search, "_clear", clear)
    timing = search.certified(search._plain_path())
    seconds = search._timed(search._plain_path()).motion.duration_s
    np.testing.assert_allclose(np.array(waits) - seconds, np.arange(min(enough, 4) + 1.0), atol=1e-9)  # quarters of 4 s
    assert (timing is None) == (enough > 4)


class Scripted(Search):
    """A search whose steps lead from one path to the next as is said: what each costs, promised and came out."""

    def __init__(self, least, steps, certified=True):
        self.program = SimpleNamespace(energy=lambda control: least)
        self.starts = SimpleNamespace(plain=None)
        self.curve = SimpleNamespace(path=lambda control: control)
        self.steps, self.yes, self.asked, self.told = list(steps), certified, [], []
        self.passes_through = False

    def _step(self, sight, price, damping):
        self.asked.append((price, damping))
        energy, broken_m, hoped = self.steps.pop(0)
        return sight_of(energy, broken_m), hoped

    def certified(self, path):
        self.told.append(float(path))
        return path if self.yes is True or self.yes.pop(0) else None

    def seen(self, control):
        return control if isinstance(control, Sight) else sight_of(float(control), 0.0)


def sight_of(energy, broken_m):
    return Sight(np.float64(energy), Rows(np.array([-broken_m]), np.zeros((1, 1)), np.zeros((1, 1))), energy)


def test_a_way_far_round_is_shortened_while_a_step_saves_enough():
    near = Scripted(10.0, [])
    assert near._shortened(sight_of(13.0, 0.0), "first", 300.0) == "first" and not near.asked
    # steps: accepted, refused twice, accepted; then it is near enough
    steps = [(18.0, 0.0, 4.0), (17.8, 0.0, 4.0), (17.9, 0.0, 4.0), (12.9, 0.0, 4.0)]
    search = Scripted(10.0, steps)
    assert search._shortened(sight_of(20.0, 0.0), "first", 300.0) == 12.9
    assert [damping for _, damping in search.asked] == pytest.approx([0.0, 0.0, 1.0, 4.0])
    assert search.told == [18.0, 12.9]
    # a step that promises 3 % or less ends it; one that keeps a tenth of its promise is taken
    little = Scripted(10.0, [(10.0, 0.0, 0.59)])
    assert little._shortened(sight_of(20.0, 0.0), "first", 300.0) == "first" and len(little.asked) == 1
    kept = Scripted(10.0, [(19.0, 0.0, 9.0), (15.0, 0.0, 9.0), (12.0, 0.0, 9.0)])
    assert kept._shortened(sight_of(20.0, 0.0), "first", 300.0) == 12.0
    assert kept.told == [19.0, 15.0, 12.0]
    # what saves less than 3 % is not worth a certificate, and a path that breaks something has none
    slight = Scripted(10.0, [(19.5, 0.0, 1.0), (12.0, 3e-5, 1.0)])
    assert slight._shortened(sight_of(20.0, 0.0), "first", 300.0) == "first" and not slight.told
    never = Scripted(10.0, [(20.0, 0.0, 4.0)] * 20)
    assert never._shortened(sight_of(20.0, 0.0), "first", 300.0) == "first" and len(never.asked) == 10
    refused = Scripted(10.0, [(15.0, 0.0, 4.0), (12.0, 0.0, 4.0)], certified=[False, True])
    assert refused._shortened(sight_of(20.0, 0.0), "first", 300.0) == 12.0 and refused.told == [15.0, 12.0]


def test_a_start_is_followed_price_by_price_until_it_is_certified():
    start = sight_of(10.0, 0.1)

    def followed(steps, effort, **more):
        search = Scripted(100.0, steps, **more)
        search.seen = lambda control: start if control is start else sight_of(float(control), 0.0)
        return search.followed(start, effort), search

    # nothing to hope for at the first price: on to the next one, with no damping
    timing, search = followed([(10.0, 0.1, 1e-9), (12.0, 1e-5, 400.0)], Effort((300.0, 3000.0), 3))
    assert timing == 12.0 and search.asked == [(300.0, 0.0), (3000.0, 0.0)]
    # halfway kept: damping falls by .3; less: it stays; refused: up to 1, then times 4
    steps = [(90.0, 0.1, 5.0), (90.0, 0.1, 5.0), (10.0, 0.08, 10.0), (10.0, 0.07, 10.0), (10.0, 0.06, 3.0)]
    _, search = followed([*steps, (10.0, 0.0, 18.0)], Effort((300.0,), 6))
    assert [damping for _, damping in search.asked] == pytest.approx([0.0, 1.0, 4.0, 1.2, 1.2, 0.36])
    slow = [(90.0, 0.1, 5.0), (10.0, 0.09, 29.0), (10.0, 0.08, 31.0), (10.0, 0.07, 3.0)]
    _, search = followed(slow, Effort((300.0,), 4))  # just more than a tenth is taken, just less is not
    assert [damping for _, damping in search.asked] == [0.0, 1.0, 1.0, 4.0]
    refused = [(10.0, 0.09, 31.0), (10.0, 0.09, 31.0), (10.0, 0.09, 3.0)]
    assert [damping for _, damping in followed(refused, Effort((300.0,), 3))[1].asked] == [0.0, 1.0, 4.0]
    # a path that is a little too near is looked at again
    timing, search = followed([(12.0, 1e-5, 28.0), (13.0, 0.0, 1.0)], Effort((300.0,), 3), certified=[False, True])
    assert timing == 12.0 and search.told == [12.0, 12.0]
    through, _ = followed([(12.0, 1e-5, 28.0)], Effort((300.0,), 1))
    assert through is None  # no step is left to certify it in


def test_a_path_that_passes_through_something_is_given_up():
    search = Scripted(100.0, [(12.0, 1e-5, 28.0)], certified=[False])
    search.passes_through = True
    start = sight_of(10.0, 0.1)

    def certified(path):
        search.passes_through = True

    search.certified = certified
    search.seen = lambda control: start
    assert search.followed(start, Effort((300.0, 3000.0), 3)) is None and len(search.asked) == 1
