"""The planner 'optimal'; what all planners have in common is in test_motion_plan.py."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from trocar.arms import ARMS, fk, ik, ik_with_fixed_wrist
from trocar.errors import ArmMoving, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.motion import (
    ArmMotion,
    MotionProblem,
    TimedPath,
    limit_use,
    plan_motion,
    plan_through,
    vertical_deviation_m,
)
from trocar.motion import optimal as module
from trocar.motion.check import line_deviation
from trocar.motion.double_integrator import shortest_common_s
from trocar.motion.straight_line import Sprint, StraightLine, quintics
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PAPER, PSM, over_the_table, transfer

SLACK = 0.02  # two recorded waypoints lie 0.3 mm beyond the nominal insertion
VERTICAL_M = 1e-6


def heights_m(arm, plan, name=PSM.name):
    """Heights of the tip at both ends of the free middle, and its least on the way."""
    first, last = plan.waypoint_times_s[name][1:3]
    z = fk(arm.model, plan.trajectories[name](np.linspace(first, last, 500))).translation_m @ arm.up
    return z[0], z[-1], z.min()


def test_recorded_transfers_are_within_2_5_percent_of_the_bound_and_strictly_vertical(recordings):
    """Facts: 1.306 s in the mean of all 22, 2.3 % above the bound; these are the eleven that were recorded."""
    with np.load(recordings / "dvrk/motion/reference_waypoints.npz") as data:
        arms = [ArmMotion(PSM, four, PAPER, straight=(True, False, True)) for four in data["waypoints"]]
    problems = [MotionProblem({PSM.name: arm}, range_slack=SLACK, straight_tolerance_m=VERTICAL_M) for arm in arms]
    plans = [plan_motion(problem, "optimal") for problem in problems]
    assert all(plan.found for plan in plans), [plan.reason for plan in plans]
    ratio = np.mean([plan.duration_s for plan in plans]) / np.mean([plan.bound_s for plan in plans])
    assert 1 < ratio < 1.025
    assert max(vertical_deviation_m(arm, p.paths[PSM.name]) for arm, p in zip(arms, plans, strict=True)) < VERTICAL_M
    for arm, plan in zip(arms, plans, strict=True):
        assert limit_use(PSM, plan.trajectory, PAPER).acceleration_ratio > 0.999  # something is always at its limit
        start, end, lowest = heights_m(arm, plan)
        assert lowest > min(start, end) - 1e-5


def test_a_lift_and_a_lowering_that_slant_because_the_wrist_is_still_are_straight_too():
    up = np.array([0.0, 0.0, 1.0])
    slanted = FOUR.copy()
    for foot, over in ((0, 1), (3, 2)):
        at_m = fk(PSM, FOUR[foot]).translation_m
        slanted[over] = ik_with_fixed_wrist(PSM, FOUR[foot], at_m + [1.5e-3, -1e-3, 0.026])
    turning, still = (ArmMotion(PSM, slanted, PAPER, up=up, fixed_wrist=still) for still in (False, True))
    assert module.straight_pieces(turning) == (False, False, False)
    assert module.straight_pieces(still) == (True, False, True)
    plan = plan_motion(MotionProblem({PSM.name: still}), "optimal")
    for piece in (0, 2):
        assert line_deviation(still, plan.paths[PSM.name], piece)[0] < VERTICAL_M


def test_no_passing_rates_near_the_chosen_ones_are_faster():
    """A descent of its own over the two rates, the costs told by sprints and closed forms, finds nothing better."""
    plan = plan_through(PSM, FOUR, PAPER, planner="optimal")
    lift, lower = StraightLine.between(PSM, FOUR[[0, 3]], FOUR[[1, 2]], PAPER)

    def seconds(rates):
        rates = np.clip(rates, 0, [lift.fastest_rate, lower.fastest_rate])
        up, down = (Sprint.to(line, np.array([rate])) for line, rate in zip((lift, lower), rates, strict=True))
        v0, v1 = lift.slope[-1] * up.rates[0], -lower.slope[-1] * down.rates[0]
        between = shortest_common_s(FOUR[2] - FOUR[1], v0, v1, PAPER.velocity, PAPER.acceleration)
        return float(up.seconds[0] + between + down.seconds[0])

    grid = [(a, b) for a in np.linspace(0, lift.fastest_rate, 25) for b in np.linspace(0, lower.fastest_rate, 25)]
    best = minimize(seconds, min(grid, key=seconds), method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-9})
    assert plan.duration_s < best.fun + 3e-4  # the search's own resolution


@pytest.mark.parametrize("name", ["psm-classic", "psm-si", "raven2-left", "raven2-right"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_transfers_of_every_arm_are_straight_and_never_sag(name, seed):
    rng = np.random.default_rng(seed)
    model = ARMS[name]
    tip = fk(model, model.middle)
    up = SO3.exp(rng.uniform(-0.3, 0.3, 3)).apply(np.array([0.0, 0.0, 1.0]))
    places = tip.translation_m + rng.uniform(-0.015, 0.015, (2, 3))
    lifts = rng.uniform(0.005, 0.02, (2, 1)) * up
    tips_m = np.stack([places[0], places[0] + lifts[0], places[1] + lifts[1], places[1]])
    turn = tip.rotation @ SO3.exp(rng.uniform(-0.3, 0.3, 3))
    turns = np.stack([tip.rotation.matrix, tip.rotation.matrix, turn.matrix, turn.matrix])
    waypoints = [model.middle]
    for matrix, place in zip(turns, tips_m, strict=True):
        try:
            waypoints.append(ik(model, SE3.from_parts(SO3(matrix), place), waypoints[-1]))
        except OutOfReach:
            assume(False)
    arm = ArmMotion(model, np.array(waypoints[1:]), model.motion_limits, up=up, straight=(True, False, True))
    plan = plan_motion(MotionProblem({name: arm}, straight_tolerance_m=5e-6, range_slack=0.2), "optimal")
    assert plan.found, plan.reason
    start, end, lowest = heights_m(arm, plan, name)
    assert lowest > min(start, end) - 2e-5


def test_a_wide_transfer_after_a_low_lift_does_not_sag():
    """Joints that go their own way would pass 3 mm below the waypoints: the remote centre is a pendulum's."""
    wide = transfer(LEFT, (-0.08, -0.05), (0.05, 0.055), lift_m=0.003)
    problem = MotionProblem({"psm1": wide}, range_slack=0.1)
    plan = plan_motion(problem, "optimal")
    assert plan.found, plan.reason
    start, end, lowest = heights_m(wide, plan, "psm1")
    assert lowest > min(start, end) - 2e-5
    lift, lower = StraightLine.between(PSM, wide.waypoints[[0, 3]], wide.waypoints[[1, 2]], PAPER)
    still = np.zeros(6)
    free = module._Stage(lift, lower, wide.waypoints[1:3], still, PAPER, wide)._fastest()[1]
    z = fk(PSM, free(np.linspace(0, free.duration_s, 200))).translation_m @ wide.up
    assert z.min() < min(z[0], z[-1]) - 1e-3  # what is forbidden here


def test_approach_retreat_and_a_plain_move():
    above, retreat, plain = FOUR[1:], FOUR[:3], FOUR[1:3]
    for points, straight in ((above, (False, True)), (retreat, (True, False)), (plain, (False,))):
        arm = ArmMotion(PSM, points, PAPER)
        said = replace(arm, straight=straight)
        plan = plan_motion(MotionProblem({"it": said}, straight_tolerance_m=VERTICAL_M), "optimal")
        assert plan.found, plan.reason
        assert plan.bound_s <= plan.duration_s < 1.12 * plan.bound_s
        unsaid = plan_motion(MotionProblem({"it": arm}), "optimal")  # it sees by itself what lies along up
        assert unsaid.duration_s == pytest.approx(plan.duration_s)


def test_every_piece_straight_rests_at_the_waypoints():
    plan = plan_motion(MotionProblem({"it": ArmMotion(PSM, FOUR, PAPER, straight=(True,) * 3)}), "optimal")
    assert plan.found, plan.reason
    np.testing.assert_allclose(plan.trajectory(plan.waypoint_times_s["it"], 1), 0, atol=1e-6)
    places = [[-0.05, 0, 0], [-0.05, 0, 0.02], [-0.03, 0.01, 0.03], [-0.02, 0, 0.02], [-0.02, 0, 0]]
    five = plan_motion(MotionProblem({"psm1": over_the_table(LEFT, places)}), "optimal")
    assert five.found, five.reason
    np.testing.assert_allclose(five.trajectory(five.waypoint_times_s["psm1"][2], 1), 0, atol=1e-6)


def test_an_approach_from_a_moving_start_saves_time_and_a_lift_from_one_is_refused():
    towards = 0.2 * (FOUR[2] - FOUR[1]) / np.abs(FOUR[2] - FOUR[1]).max()
    resting, going = (plan_through(PSM, FOUR[1:], PAPER, planner="optimal", start_velocity=k * towards) for k in (0, 1))
    assert resting.found and going.found
    assert going.duration_s < resting.duration_s
    np.testing.assert_allclose(going.trajectory(0.0, 1), towards, atol=1e-9)
    refused = plan_through(PSM, FOUR, PAPER, planner="optimal", start_velocity=towards)
    assert not refused.found and isinstance(refused.refusal, ArmMoving)


def test_the_greatest_acceleration_of_quintics_is_at_a_knot_or_what_is_found_between():
    rng = np.random.default_rng(0)
    between = 0
    for _ in range(20):
        times_s = np.cumsum([0.0, *rng.uniform(0.5, 1.5, 3)])
        motion = quintics(times_s, *(rng.normal(size=(n, 3)) for n in (4, 4, 3, 3)))
        knots = np.concatenate([motion.times_s[:-1], np.nextafter(motion.times_s[1:], 0)])
        at_knots = np.abs(motion(knots, 2)).max(axis=0)
        dense = np.abs(motion(np.linspace(0.0, motion.times_s[-1], 6001), 2)).max(axis=0)
        found = module._most_acceleration(motion)
        np.testing.assert_allclose(np.maximum(found, at_knots), np.maximum(dense, at_knots), rtol=1e-5)
        between += (found > 1.01 * at_knots).sum()
    assert between > 5
    even = Trajectory(np.array([0.0, 1.0]), rng.normal(size=(5, 1, 2)))
    assert not module._most_acceleration(even).any()  # such pieces are within their limits by themselves


def test_rates_at_the_end_of_a_straight_piece_and_what_they_cost():
    (line,) = StraightLine.between(PSM, FOUR[[0]], FOUR[[1]], PAPER)
    end = module._End.of(line)
    grid = end.first_grid()
    np.testing.assert_allclose(grid, np.linspace(0, line.fastest_rate, 16))
    np.testing.assert_array_equal(end.slope, line.slope[-1])
    some = np.array([0.1, 0.55]) * line.fastest_rate
    np.testing.assert_allclose(end.seconds(some), Sprint.to(line, some).seconds, rtol=1e-3)
    for place, between in ((0, (0, 1)), (7, (6, 8)), (15, (14, 15))):
        np.testing.assert_allclose(end.finer(grid, place), np.linspace(*grid[list(between)], 9))
    none = module._End.of(None)
    assert none.first_grid().tolist() == [0.0] and none.finer(np.zeros(1), 0).tolist() == [0.0]
    assert none.top == none.slope == 0.0 and none.seconds(np.zeros(1)).tolist() == [0.0]


def turned_and_moved(aside, turn_rad, fixed_wrist):
    arm = replace(ArmMotion(PSM, FOUR, PAPER), fixed_wrist=fixed_wrist)
    begin = SE3.from_parts(SO3.axis("x", np.array([0.4])), [[0.1, 0.0, -0.1]])
    way = np.array([np.sin(aside), 0.0, np.cos(aside)]) * 0.03
    end = SE3.from_parts(begin.rotation @ SO3.axis("y", np.array([turn_rad])), begin.translation_m + way)
    (found,) = module._are_along_up(arm, begin, end)
    return bool(found)


@pytest.mark.parametrize(("fixed_wrist", "most"), [(False, 1e-3), (True, 0.25)])
def test_a_piece_lies_along_up_if_it_hardly_leads_aside_and_hardly_turns(fixed_wrist, most):
    for share, along in ((0.98, True), (1.02, False)):
        assert turned_and_moved(np.arcsin(share * most), 0.0, fixed_wrist) == along
        assert turned_and_moved(np.pi - np.arcsin(share * most), 0.0, fixed_wrist) == along  # downwards
        assert turned_and_moved(0.0, share * most, fixed_wrist) == along


def test_only_the_first_and_the_last_of_several_pieces_may_be_straight_unsaid():
    def found(points):
        return module.straight_pieces(ArmMotion(PSM, points, PAPER))

    assert found(FOUR) == (True, False, True)
    assert found(FOUR[:2]) == (False,)
    assert found(FOUR[[0, 1, 0, 1]]) == (True, False, True)
    assert found(FOUR[[1, 2, 3]]) == (False, True) and found(FOUR[[0, 1, 2]]) == (True, False)
    assert module.straight_pieces(ArmMotion(PSM, FOUR, PAPER, straight=(False, True, False))) == (False, True, False)


@pytest.mark.parametrize("low_first", [True, False])
@pytest.mark.parametrize("beside", ["lift", "lower", "both", "aside", "none"])
def test_a_free_piece_may_pass_a_hundredth_of_a_millimetre_below_its_lower_end(beside, low_first):
    """The insertion alone moves the tip along the tool's axis: that is up here."""
    begin = np.array([0, 0, 0.15, 0, 0, 0])
    up = fk(PSM, begin).translation_m - fk(PSM, begin + [0, 0, 0.01, 0, 0, 0]).translation_m
    points = np.stack([begin + [0, 0, 0.02, 0, 0, 0], begin, begin, begin + [0, 0, 0.02, 0, 0, 0]])
    (lift,) = StraightLine.between(PSM, points[[0]], points[[1]], PAPER)
    (aside,) = StraightLine.between(PSM, FOUR[[1]], FOUR[[2]], PAPER)
    lines = {"lift": (lift, None), "lower": (None, lift), "both": (lift, lift), "aside": (aside, None)}
    arm = ArmMotion(PSM, FOUR, PAPER, up=up)
    stage = module._Stage(*lines.get(beside, (None, None)), points[1:3], np.zeros(6), PAPER, arm)
    for sag_m, rises in ((0.9e-5, True), (1.1e-5, beside in ("aside", "none")), (-1e-3, True)):
        knots = np.zeros((3, 6))
        knots[1, 2], knots[2 if low_first else 0, 2] = sag_m, -5e-3
        motion = Trajectory.hermite([0.0, 19 / 39, 1.0], begin + knots, np.zeros((3, 6)))  # the 20th of 40 samples
        assert stage._rises(motion) == rises


def test_pieces_that_sag_are_straight_and_rest_in_between():
    wide = transfer(LEFT, (-0.08, -0.05), (0.05, 0.055), lift_m=0.003)
    lift, lower = StraightLine.between(PSM, wide.waypoints[[0, 3]], wide.waypoints[[1, 2]], PAPER)
    for lines, points, count in (
        ((lift, lower), wide.waypoints, 3),
        ((lift, None), wide.waypoints[:3], 2),
        ((None, lower), wide.waypoints[1:], 2),
    ):
        free = points[int(lines[0] is not None) :][:2]
        pieces = module._Stage(*lines, free, np.zeros(6), PAPER, wide).pieces()
        assert len(pieces) == count
        for motion, begin, end in zip(pieces, points[:-1], points[1:], strict=True):
            np.testing.assert_allclose(motion(np.array([0.0, motion.duration_s])), [begin, end], atol=1e-9)
            np.testing.assert_allclose(motion(np.array([0.0, np.nextafter(motion.duration_s, 0)]), 1), 0, atol=1e-6)


def test_it_is_planned_again_until_no_acceleration_is_beyond_its_limit(monkeypatch):
    asked = []

    def joined(arm, straight, limits):
        share = float((limits.acceleration / PAPER.acceleration).max())
        asked.append(share)
        coefficients = np.zeros((6, 1, 6))
        coefficients[3, 0, 0] = 1.01 * share * PAPER.acceleration[0] / 2  # one percent too much
        return TimedPath(Trajectory(np.array([0.0, 1.0]), coefficients), [0.0, 1.0])

    monkeypatch.setattr(module, "_joined", joined)
    path = module._planned(ArmMotion(PSM, FOUR[:2], PAPER))
    assert asked == pytest.approx([1 - 1e-6, (1 - 1e-6) / 1.01], rel=1e-6)
    assert module._most_acceleration(path.trajectory)[0] <= PAPER.acceleration[0]
    asked.clear()
    monkeypatch.setattr(module, "_most_acceleration", lambda motion: 2 * PAPER.acceleration)
    module._planned(ArmMotion(PSM, FOUR[:2], PAPER))
    assert asked == pytest.approx(2.0 ** -np.arange(5), rel=1e-5)
