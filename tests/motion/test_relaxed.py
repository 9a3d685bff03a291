"""The planner 'relaxed', and the tolerances of waypoints that it uses."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import sparse

from trocar.arms import ARMS, MotionLimits, fk, ik
from trocar.errors import OutOfReach, TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import ArmMotion, MotionProblem, TimedPath, duration_bound_s, plan_motion, rest_to_rest
from trocar.motion import relaxed as module
from trocar.motion.spline_program import JointSpline, Rows
from trocar.motion.tolerances import joint_strays, line_deviation, passing_deviation, sag_m
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT, transfer

NEAR = {
    "straight_tolerance_m": 1e-3,
    "straight_tolerance_rad": 0.105,
    "waypoint_tolerance_m": 1e-3,
    "waypoint_tolerance_rad": 0.105,
}
UPRIGHT = (True, False, True)


def asking(points=FOUR, limits=PAPER, straight=UPRIGHT, model=PSM, **asked):
    return MotionProblem({"it": ArmMotion(model, points, limits, straight=straight)}, **{**NEAR, **asked})


def test_recorded_transfers_are_4_percent_shorter_with_a_millimetre_and_the_clearance_is_kept(recordings):
    """Facts: 5 % with a slow method that looked every 20 ms; here everything is checked at 1 kHz."""
    with np.load(recordings / "dvrk/motion/reference_waypoints.npz") as data:
        problems = [asking(four, range_slack=0.02) for four in data["waypoints"]]
    plans, exact = ([plan_motion(problem, name) for problem in problems] for name in ("relaxed", "optimal"))
    assert all(plan.found for plan in plans), [plan.reason for plan in plans]
    means = [np.mean([plan.duration_s for plan in some]) for some in (plans, exact)]
    assert means[0] < 0.96 * means[1]
    assert all(plan.bound_s < plan.duration_s for plan in plans)
    assert np.mean([plan.bound_s for plan in plans]) > 0.98 * means[0]
    assert max(plan.use["it"].acceleration_ratio for plan in plans) <= 1 + 1e-9
    # pegs of 20 mm, blocks 15 mm high, their hole 2.1 mm wider all round (facts, "The board and the blocks")
    for problem, plan in zip(problems, plans, strict=True):
        assert off_the_peg_m(problem.arms["it"], plan.paths["it"]) < 2.1e-3


def off_the_peg_m(arm, path):
    """How far the ends of the hole, 5 mm aside of the grasp, are off the peg's axis while the peg is in it."""
    worst = 0.0
    for foot, (begin, end) in ((0, path.waypoint_times_s[:2]), (3, path.waypoint_times_s[2:])):
        tips, standing = (
            fk(arm.model, path.trajectory(np.linspace(begin, end, 300))),
            fk(arm.model, arm.waypoints[foot]),
        )
        lifted = tips.translation_m[:, 2] - standing.translation_m[2]
        for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
            for below in (0.0, 0.0149):
                end_m = standing.translation_m + [0.005 * np.cos(angle), 0.005 * np.sin(angle), -below]
                off = tips.apply(standing.inverse().apply(end_m)) - end_m
                worst = max(worst, np.linalg.norm(off[lifted < 0.02, :2], axis=1).max())
    return worst


def test_more_clearance_is_never_slower_and_none_is_the_exact_motion():
    exact = plan_motion(asking(), "optimal")
    seconds = [
        plan_motion(
            asking(**{name: share * value for name, value in NEAR.items()}),
            "relaxed",
        ).duration_s
        for share in (0.25, 0.5, 1.0, 2.0)
    ]
    assert np.all(np.diff(seconds) < 0) and seconds[0] < exact.duration_s
    none = dict.fromkeys(NEAR, 0.0)
    plan = plan_motion(asking(**{**none, "straight_tolerance_m": 1e-5, "straight_tolerance_rad": 1e-5}), "relaxed")
    assert plan.found and plan.duration_s == exact.duration_s


def test_the_tip_leans_to_the_target_and_never_dips_below_where_it_starts_and_ends():
    plan = plan_motion(asking(), "relaxed")
    tips = fk(PSM, plan.trajectory(np.linspace(0, plan.duration_s, 3000))).translation_m
    ends = fk(PSM, FOUR[[0, 3]]).translation_m
    assert tips[:1500, 2].min() > ends[0, 2] - 5e-5 and tips[1500:, 2].min() > ends[1, 2] - 5e-5
    times = plan.waypoint_times_s["it"]
    arm = asking().arms["it"]
    for waypoint in (1, 2):
        off_m, off_rad = passing_deviation(arm, plan.paths["it"], waypoint)
        assert 0.5e-3 < off_m <= 1e-3 and 0.0 < off_rad <= 0.105
    assert sag_m(arm, plan.paths["it"], 1) <= 1e-3
    assert 0 < times[1] < times[2] < times[3]


@pytest.mark.parametrize("name", ["psm-classic", "psm-si", "raven2-left"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_transfers_of_every_arm_keep_the_clearance(name, seed):
    rng = np.random.default_rng(seed)
    model = ARMS[name]
    tip = fk(model, model.middle)
    places = tip.translation_m + rng.uniform(-0.015, 0.015, (2, 3))
    lifts = rng.uniform(0.005, 0.02, (2, 1)) * [0, 0, 1]
    tips_m = np.stack([places[0], places[0] + lifts[0], places[1] + lifts[1], places[1]])
    turn = (tip.rotation @ SO3.exp(rng.uniform(-0.3, 0.3, 3))).matrix
    points = [model.middle]
    for matrix, place in zip([tip.rotation.matrix] * 2 + [turn] * 2, tips_m, strict=True):
        try:
            points.append(ik(model, SE3.from_parts(SO3(matrix), place), points[-1]))
        except OutOfReach:
            assume(False)
    problem = asking(np.array(points[1:]), model.motion_limits, model=model, range_slack=0.2)
    plan, exact = plan_motion(problem, "relaxed"), plan_motion(problem, "optimal")
    assert plan.found, plan.reason
    assert plan.bound_s <= plan.duration_s <= exact.duration_s


def test_approach_and_retreat_gain_too_and_what_it_does_not_know_is_exact():
    for points, straight in ((FOUR[1:], (False, True)), (FOUR[:3], (True, False))):
        problem = asking(points, straight=straight)
        plan, exact = plan_motion(problem, "relaxed"), plan_motion(problem, "optimal")
        assert plan.found, plan.reason
        assert plan.bound_s < plan.duration_s < exact.duration_s
    for points, straight in ((FOUR[1:3], (False,)), (FOUR, (True,) * 3)):
        problem = asking(points, straight=straight)
        assert plan_motion(problem, "relaxed").duration_s == plan_motion(problem, "optimal").duration_s


def test_a_moving_start_is_planned_exactly():
    start = 0.2 * (FOUR[2] - FOUR[1]) / np.abs(FOUR[2] - FOUR[1]).max()
    moving = replace(asking(FOUR[1:], straight=(False, True)).arms["it"], start_velocity=start)
    plan = plan_motion(MotionProblem({"it": moving}, **NEAR), "relaxed")
    assert plan.found, plan.reason
    assert plan.duration_s == plan_motion(MotionProblem({"it": moving}, **NEAR), "optimal").duration_s


def test_velocity_limits_that_bind_are_kept():
    slow = MotionLimits(0.3 * PAPER.velocity, PAPER.acceleration)
    plan, exact = (plan_motion(asking(limits=slow), name) for name in ("relaxed", "optimal"))
    assert plan.found, plan.reason
    assert plan.use["it"].velocity_ratio > 0.95
    assert plan.duration_s < exact.duration_s


def test_each_of_several_arms_moves_as_if_it_were_alone():
    arms = {
        "psm1": transfer(LEFT, (-0.06, 0.0), (-0.03, 0.01), straight=UPRIGHT),
        "psm2": transfer(RIGHT, (0.06, 0.0), (0.03, 0.02), straight=UPRIGHT),
    }
    plan = plan_motion(MotionProblem(arms, **NEAR), "relaxed")
    assert plan.found, plan.reason
    for name, arm in arms.items():
        alone = plan_motion(MotionProblem({name: arm}, **NEAR), "relaxed")
        assert alone.duration_s == plan.trajectories[name].duration_s


def lowered(by_m, turn_rad=0.0):
    """A planner that rests at waypoints whose inner ones are lower and turned."""

    def planner(problem):
        tips = fk(PSM, FOUR)
        shift = np.array([0, by_m, by_m, 0])[:, None] * [0, 0, -1]
        turn = SO3.exp(np.array([0, turn_rad, turn_rad, 0])[:, None] * [0, 0, 1])
        points = ik(PSM, SE3.from_parts(tips.rotation @ turn, tips.translation_m + shift))
        points[[0, 3]] = FOUR[[0, 3]]
        return {"it": TimedPath.joined([rest_to_rest(a, b, PAPER) for a, b in pairwise(points)])}

    return planner


def test_the_check_knows_the_tolerances_and_what_sags():
    free = {"straight": (False,) * 3}
    assert not plan_motion(asking(waypoint_tolerance_m=0.0, **free), lowered(0.5e-3)).found
    assert "misses waypoint 1" in plan_motion(asking(**free), lowered(1.5e-3)).reason
    assert "misses waypoint 1" in plan_motion(asking(**free), lowered(0.0, 0.13)).reason
    sagging = plan_motion(asking(**free), lowered(0.5e-3))  # joints in a line between them: a pendulum
    assert "sinks" in sagging.reason and "below its waypoints on piece 1, not 1.000 mm" in sagging.reason
    assert plan_motion(asking(**free, waypoint_tolerance_m=0.02), lowered(0.5e-3)).found


@pytest.mark.parametrize("name", ["waypoint_tolerance_m", "waypoint_tolerance_rad"])
def test_a_tolerance_is_a_finite_number(name):
    for bad in (-1e-3, np.nan):
        with pytest.raises(TrocarError, match=f"{name} of a motion problem is"):
            asking(**{name: bad})


def test_the_bound_of_waypoints_with_a_tolerance_is_lower_and_holds_for_each_choice_within():
    problem = asking()
    strays = joint_strays(problem.arms["it"], problem)
    bound = duration_bound_s(FOUR, PAPER, None, strays)
    assert bound < duration_bound_s(FOUR, PAPER)
    rng = np.random.default_rng(0)
    tips = fk(PSM, FOUR[1:3])
    least = []
    for _ in range(200):
        turn = rng.normal(size=(2, 3))
        turn *= 0.105 * rng.uniform(0, 1, (2, 1)) / np.linalg.norm(turn, axis=1, keepdims=True)
        shift = rng.uniform(-1, 1, (2, 3)) * [0.7e-3, 0.7e-3, 1e-3]
        inner = ik(PSM, SE3.from_parts(SO3.exp(turn) @ tips.rotation, tips.translation_m + shift))
        assert np.all(np.abs(inner - FOUR[1:3]) <= strays[1:3])
        least.append(duration_bound_s(np.stack([FOUR[0], *inner, FOUR[3]]), PAPER))
    assert bound <= min(least) < duration_bound_s(FOUR, PAPER)
    assert joint_strays(problem.arms["it"], MotionProblem(problem.arms)) is None


PASSED = np.array([0.0, 0.25, 0.7, 1.0])
UNEVEN = np.stack([FOUR[0], (FOUR[0] + FOUR[1]) / 2, FOUR[2], FOUR[3]])  # lifted less than it is lowered
T_S = 2.0


def spline_motion(points=FOUR, limits=PAPER, straight=UPRIGHT, passed=PASSED):
    """A clearance, a spline between the ends of its waypoints, what is free of it, and the motion that it makes."""
    problem = asking(points, limits, straight)
    clearance = module._Clearance.of(problem, problem.arms["it"])
    pieces = [np.linspace(a, b, 4, endpoint=False) for a, b in pairwise(passed)]
    spline = JointSpline(np.concatenate([*pieces, [1.0]]), 2, points[[0, 0]], points[[-1, -1]])
    x = 0.02 * np.random.default_rng(0).normal(size=6 * spline.free)
    return clearance, spline, x, TimedPath(spline.trajectory(spline.control(x), T_S), T_S * passed)


def room(rows, x, square=T_S**2):
    """What is left above the lower and below the upper bounds of rows."""
    columns = rows.free + rows.extras
    data, row, column = (np.concatenate([getattr(b, name) for b in rows.blocks]) for name in ("data", "row", "column"))
    low, high = np.concatenate(rows.lows), np.concatenate(rows.highs)
    values = sparse.csr_matrix((data, (row, column)), shape=(len(low), columns)) @ np.append(x, square)
    return values - low, high - values


def rows_of(spline):
    return Rows(6 * spline.free, 1)


def test_accelerations_are_bounded_by_the_square_of_the_time_and_fast_joints_by_the_time():
    clearance, spline, x, path = spline_motion(limits=MotionLimits(np.full(6, 1e3), PAPER.acceleration))
    rows = rows_of(spline)
    clearance._bound_rates(rows, spline, path.trajectory)
    pushes = (path.trajectory(path.trajectory.times_s[:-1], 2) / PAPER.acceleration).T.ravel() * T_S**2
    np.testing.assert_allclose(room(rows, x)[1], np.concatenate([T_S**2 - pushes, T_S**2 + pushes]))
    speeds = path.trajectory(path.trajectory.times_s, 1)
    for share, more in ((0.79, 0), (0.81, 2)):
        limits = MotionLimits(np.where(np.arange(6) == 4, np.abs(speeds[:, 4]).max() / share, 1e3), PAPER.acceleration)
        clearance, spline, x, path = spline_motion(limits=limits)
        rows = rows_of(spline)
        clearance._bound_rates(rows, spline, path.trajectory)
        assert len(rows.blocks) == 2 + more
    fast = (speeds[1:-1] / limits.velocity).T.ravel() * T_S
    left = room(rows, x)[1][-2 * len(fast) :]
    np.testing.assert_allclose(left, np.concatenate([T_S - fast, T_S + fast]))
    shorter = room(rows, x, 0.81 * T_S**2)[1][-2 * len(fast) :]  # a tangent of .9 T, above it
    np.testing.assert_allclose(shorter - left, -0.19 / 2 * T_S)


def test_smoothness_is_the_squared_change_of_acceleration_in_limits():
    clearance, spline, x, path = spline_motion()
    still = spline.trajectory(spline.control(0 * x), T_S)
    times = path.trajectory.times_s[:-1]
    pushes = (path.trajectory(times, 2) - still(times, 2)) / PAPER.acceleration
    wanted = 1e-5 * np.square(np.diff(pushes, axis=0)).sum()
    found = np.append(x, 7.0) @ clearance._smoothness(spline, T_S) @ np.append(x, 7.0)
    assert found == pytest.approx(wanted)


def test_boxes_lie_within_the_balls_of_the_tolerances():
    for shares in (module.SIDES, module.TURNS):
        assert 0.99 < np.linalg.norm(shares) <= 1 / module.ROOM


@pytest.mark.parametrize("foot", [0, 3])
def test_a_channel_bounds_where_the_tip_is_and_how_it_is_turned(foot):
    clearance, spline, x, path = spline_motion()
    at = np.array([0.02, 0.1, 0.2]) if foot == 0 else np.array([0.75, 0.9, 0.97])

    def told(x):
        tips = fk(PSM, spline.trajectory(spline.control(x), T_S)(T_S * at))
        gone = tips.translation_m - fk(PSM, FOUR[foot]).translation_m
        turned = (tips.rotation @ fk(PSM, FOUR[foot]).rotation.inverse()).log()
        return np.concatenate([gone @ clearance._axes.T, turned @ clearance._axes.T], axis=1).T

    rows = rows_of(spline)
    clearance._bound_channel(rows, spline, path, foot, at)
    below, above = (left.reshape(6, -1) for left in room(rows, x))
    sides = 0.995 * np.array([0.97e-3, 0.24e-3, np.inf, 0.26 * 0.105, 0.93 * 0.105, 0.26 * 0.105])
    aside = [0, 1, 3, 4, 5]
    np.testing.assert_allclose(above[aside], sides[aside, None] - told(x)[aside], atol=1e-9)
    np.testing.assert_allclose(below[aside], sides[aside, None] + told(x)[aside], atol=1e-9)
    np.testing.assert_allclose(below[2], told(x)[2], atol=1e-9)  # not below its foot
    assert above[2].min() > 1e30
    step = 1e-5 * np.random.default_rng(1).normal(size=len(x))
    change = (told(x + step) - told(x - step)) / 2
    found = room(rows, x + step)[0].reshape(6, -1) - below
    np.testing.assert_allclose(found[:3], change[:3], atol=1e-8)
    np.testing.assert_allclose(found[3:], change[3:], atol=6e-7)  # the tip is turned aside by a few degrees


@pytest.mark.parametrize(
    ("points", "straight", "passed", "over"),
    [
        (FOUR, UPRIGHT, PASSED, [0.25, 0.3625, 0.475, 0.5875, 0.7]),
        (UNEVEN, UPRIGHT, PASSED, [0.25, 0.3625, 0.475, 0.5875, 0.7]),
        (UNEVEN[::-1], UPRIGHT, PASSED, [0.25, 0.3625, 0.475, 0.5875, 0.7]),
        (FOUR[1:], (False, True), PASSED[[0, 2, 3]], [0.175, 0.35, 0.525, 0.7]),
        (FOUR[:3], (True, False), PASSED[[0, 1, 3]], [0.25, 0.4375, 0.625, 0.8125]),
    ],
)
def test_between_lift_and_lowering_the_tip_stays_above_a_floor(points, straight, passed, over, monkeypatch):
    clearance, spline, x, path = spline_motion(points, straight=straight, passed=passed)
    looked_at = {}
    monkeypatch.setattr(module._Clearance, "_bound_channel", lambda *given: looked_at.update({given[4]: given[5]}))
    rows = rows_of(spline)
    clearance._bound_tip(rows, spline, path, passed)
    heights = fk(PSM, path.trajectory(T_S * np.array(over))).translation_m[:, 2]
    inner = fk(PSM, points[1:-1]).translation_m[:, 2]
    ends = fk(PSM, points).translation_m[:, 2][int(straight[0]) : len(points) - int(straight[-1])]
    floor = np.full(len(over), ends.min() - 0.995e-3)
    for share, height in zip(passed[1:-1], inner, strict=True):
        floor[np.isclose(over, share)] = height - 0.995e-3
    below, above = room(rows, x)
    np.testing.assert_allclose(below, heights - floor, atol=1e-9)
    assert above.min() > 1e30
    if straight[0]:
        inside = spline.shares[1:4]
        np.testing.assert_allclose(looked_at[0], np.union1d(inside, np.linspace(inside[1], passed[1], 9)))
    if straight[-1]:
        inside = spline.shares[-4:-1]
        at = looked_at[len(points) - 1]
        np.testing.assert_allclose(at, np.union1d(inside, np.linspace(passed[-2], inside[1], 9)))
    assert len(looked_at) == sum(straight)


def test_axes_lead_to_the_target_aside_and_up():
    clearance = spline_motion()[0]
    ahead, aside, up = clearance._axes
    way = fk(PSM, FOUR[3]).translation_m - fk(PSM, FOUR[0]).translation_m
    np.testing.assert_allclose(up, [0, 0, 1])
    np.testing.assert_allclose(ahead, [*(way[:2] / np.linalg.norm(way[:2])), 0], atol=1e-12)
    np.testing.assert_allclose(aside, np.cross(up, ahead), atol=1e-12)
    for tilted in (np.eye(3)[0], np.eye(3)[1], np.eye(3)[2]):  # straight above, any axes will do
        arm = replace(asking().arms["it"], waypoints=FOUR[[0, 1, 0, 1]], up=tilted)
        above = replace(clearance, arm=arm, tips=fk(PSM, np.stack([FOUR[0]] * 4)))
        np.testing.assert_allclose(above._axes @ above._axes.T, np.eye(3), atol=1e-12)


def test_waypoints_are_passed_at_the_height_where_their_tolerance_begins():
    clearance, _, _, _ = spline_motion()
    plan = plan_motion(asking(), "optimal")
    path = clearance._passing(plan.trajectory)
    first, last = path.waypoint_times_s[[0, -1]]
    assert (first, last) == (0.0, plan.duration_s)
    heights = fk(PSM, plan.trajectory(path.waypoint_times_s[1:3])).translation_m[:, 2]
    wanted = fk(PSM, FOUR[1:3]).translation_m[:, 2] - 1e-3
    assert np.all(heights >= wanted) and np.all(heights < wanted + 3e-4)  # the next of samples at 1 kHz
    before, after = path.waypoint_times_s[1] - 2e-3, path.waypoint_times_s[2] + 2e-3
    assert fk(PSM, plan.trajectory(before)).translation_m[2] < wanted[0]
    assert fk(PSM, plan.trajectory(after)).translation_m[2] < wanted[1]
    high = replace(clearance, height_m=clearance.height_m + 0.1)
    assert high._passing(plan.trajectory) is None


def test_there_is_something_to_gain_only_from_tolerances_on_what_is_lifted_upright():
    def gains(points=FOUR, straight=UPRIGHT, start=0.0, **asked):
        problem = asking(points, straight=straight, **asked)
        arm = replace(problem.arms["it"], start_velocity=np.full(6, start))
        return module._Clearance.of(problem, arm).gains

    assert gains() and gains(FOUR[1:], (False, True)) and gains(FOUR[:3], (True, False))
    assert not gains(straight=(True, True, True)) and not gains(FOUR[1:3], (False,)) and not gains(start=1e-3)
    for name in NEAR:
        assert not gains(**{name: 0.0})
    slanted = fk(PSM, FOUR)
    for aside_m, enough in ((0.9 * 0.005e-3, True), (1.1 * 0.005e-3, False)):  # half a percent of the tolerance
        for index in (1, 2):
            tips_m = slanted.translation_m.copy()
            tips_m[index, 0] += aside_m
            assert gains(ik(PSM, SE3.from_parts(slanted.rotation, tips_m))) == enough


def test_what_a_motion_uses_of_its_tolerances():
    clearance = module._Clearance.of(asking(), asking().arms["it"])
    exact = clearance.used(plan_motion(asking(), "optimal").paths["it"])
    assert exact[0] < 0.01 and exact[1] < 0.01 and exact[2] <= 0.011
    path = lowered(0.5e-3, 0.01)(asking())["it"]
    half = replace(clearance, off_m=0.5e-3, off_rad=0.0525, below_m=0.5e-3)
    np.testing.assert_allclose(half.used(path), 2 * np.array(clearance.used(path)))
    strays = np.array([line_deviation(clearance.arm, path, piece) for piece in (0, 2)]).max(axis=0)
    np.testing.assert_allclose(clearance.used(path)[:2], strays / [1e-3, 0.105])
    assert clearance.used(path)[2] == pytest.approx(sag_m(clearance.arm, path, 1) / 1e-3)
