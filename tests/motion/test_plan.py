from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import MotionLimits, fk
from trocar.errors import ArmMoving, InvalidInput, MotionRefused, NoPlan, TrocarError
from trocar.geometry import SE3
from trocar.motion import (
    PLANNERS,
    ArmMotion,
    Capsule,
    Demand,
    HalfSpace,
    MotionProblem,
    MovingArm,
    TimedPath,
    ignores,
    plan_motion,
    plan_through,
    rest_to_rest,
    straight,
)
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT, over_the_table, stops, transfer

ASIDE_LEFT = transfer(LEFT, (-0.06, 0.0), (-0.03, 0.01))
ASIDE_RIGHT = transfer(RIGHT, (0.06, 0.0), (0.03, 0.01))


def asking(motion=None, **asked):
    return MotionProblem({"psm1": motion or ArmMotion(PSM, FOUR, PAPER)}, **asked)


def moved(change):
    """The sound planner, its trajectories and times changed."""

    def planner(problem):
        return {
            name: TimedPath(*change(path.trajectory, path.waypoint_times_s)) for name, path in stops(problem).items()
        }

    return planner


def test_a_sound_answer_is_found():
    plan = plan_motion(asking(), stops)
    assert plan.found and not plan.violations and plan.planner == "stops"
    assert plan.trajectory is plan.trajectories["psm1"]
    assert plan.use["psm1"].acceleration_ratio == pytest.approx(1, abs=1e-9)
    assert plan.bound_s < plan.duration_s and plan.compute_ms > 0
    assert repr(plan) == f"<MotionPlan of psm1 by 'stops': {plan.duration_s:.3f} s>"


def test_a_jerk_that_is_limited_is_checked_and_so_is_an_acceleration_that_jumps():
    limits = MotionLimits(PAPER.velocity, PAPER.acceleration, jerk=np.full(6, 1e9))
    plan = plan_motion(asking(ArmMotion(PSM, FOUR, limits)))
    assert "uses inf of its jerk limit; 'spline' ignores jerk" in plan.reason


def test_a_refused_plan_keeps_its_paths_and_raises_its_refusal():
    plan = plan_motion(asking(), moved(lambda path, times: (path.stretched(0.9), 0.9 * times)))
    assert not plan.found and plan.paths  # to be looked at
    assert "uses 1.235 of its acceleration limit" in plan.reason
    with pytest.raises(MotionRefused, match="is refused") as raised:
        plan.trajectories  # noqa: B018
    assert raised.value is plan.refusal and str(plan.refusal) == plan.reason


def test_straight_pieces_are_checked():
    asked = ArmMotion(PSM, FOUR, PAPER, straight=(True, False, True))
    plan = plan_motion(asking(asked))
    assert "strays" in plan.reason and "straight piece 0, not 0.100 mm (and 1 more)" in plan.reason
    assert "'spline' ignores straight pieces" in plan.reason
    assert plan_motion(asking(asked, straight_tolerance_m=2e-3)).found

    def upright(problem):
        arm = problem.arms["psm1"]
        tips = fk(PSM, arm.waypoints).translation_m
        up = straight(PSM, arm.waypoints[0], tips[1] - tips[0], PAPER)
        down = straight(PSM, arm.waypoints[2], tips[3] - tips[2], PAPER)
        return {"psm1": TimedPath.joined([up, rest_to_rest(*arm.waypoints[1:3], PAPER), down])}

    plan = plan_motion(asking(asked), upright)
    assert plan.found, plan.reason


def test_what_a_planner_does_not_see_is_told_only_where_it_matters():
    aside = asking(ASIDE_LEFT, obstacles={"table": HalfSpace([0, 0, -0.01], [0, 0, 1])}, min_distance_m=2e-3)
    assert plan_motion(aside).found
    x, y, z = fk(PSM, plan_motion(aside).trajectory(0.8)).translation_m
    T_world_base = aside.arms["psm1"].T_world_base
    on_the_way = T_world_base.apply(np.array([x, y, z]))
    hit = replace(aside, obstacles={"peg": Capsule(on_the_way, radius_m=1e-4)})
    plan = plan_motion(hit)
    assert not plan.found
    assert "overlaps peg at 0." in plan.reason and "2.00 mm were to be kept" in plan.reason
    assert "'spline' ignores distances" in plan.reason
    low = replace(aside, obstacles={"table": HalfSpace([0, 0, -0.004], [0, 0, 1])}, min_distance_m=2e-3)
    assert "may come within 1." in plan_motion(low).reason  # the capsule of a finger ends 2.3 mm beyond it


def test_open_jaws_need_more_room():
    end_s = plan_motion(asking(ASIDE_LEFT)).duration_s
    opened = MovingArm.resting(PSM, ASIDE_LEFT.waypoints[-1], LEFT, jaw_rad=1.0).ends_m(np.array([end_s]))[0, 2, 1]
    wire = {"wire": Capsule(opened, radius_m=1e-4)}
    assert plan_motion(asking(ASIDE_LEFT, obstacles=wire)).found
    assert "finger overlaps wire" in plan_motion(asking(replace(ASIDE_LEFT, jaw_rad=1.0), obstacles=wire)).reason


def test_a_registered_planner_that_sees_more_is_recommended():
    PLANNERS.register("sees-all", stops)
    try:
        reason = plan_motion(asking(ArmMotion(PSM, FOUR, PAPER, straight=(True,) * 3))).reason
    finally:
        PLANNERS.forget("sees-all")
    assert "'spline' ignores straight pieces, try " in reason and reason.endswith(", sees-all")


@pytest.mark.parametrize("planner", [None, "spline", lambda: {}, lambda problem, limits: {}])
def test_what_cannot_be_called_with_a_problem_is_no_planner(registries, planner):
    with pytest.raises(InvalidInput, match=r"planner 'mine' is .*; register a function of a MotionProblem"):
        PLANNERS.register("mine", planner)
    PLANNERS.register("mine", lambda problem, patience_s=1.0: {})


@pytest.mark.parametrize("planner", PLANNERS)
def test_two_arms_start_together_and_the_last_one_ends_the_plan(planner):
    problem = MotionProblem({"psm1": ASIDE_LEFT, "psm2": ASIDE_RIGHT}, min_distance_m=1e-3)
    plan = plan_motion(problem, planner)
    assert plan.found, plan.reason
    assert plan.duration_s == max(motion.duration_s for motion in plan.trajectories.values())
    assert plan.clearance.distance_m > 1e-3
    alone = [plan_motion(MotionProblem({name: arm}), planner) for name, arm in problem.arms.items()]
    assert plan.bound_s == max(one.bound_s for one in alone)
    if planner != "convex":  # it plans all arms together; to the others each is as if it were alone
        for one, both in zip(alone, plan.trajectories.values(), strict=True):
            np.testing.assert_array_equal(one.trajectory.coefficients, both.coefficients)
    with pytest.raises(TrocarError, match="moves psm1, psm2; take one"):
        plan.trajectory  # noqa: B018


def test_two_arms_that_meet_are_refused_and_so_is_one_that_meets_a_known_motion():
    first = transfer(LEFT, (-0.04, 0.01), (0.03, 0.0))
    second = transfer(RIGHT, (0.04, 0.01), (-0.03, 0.0))
    both = plan_motion(MotionProblem({"psm1": first, "psm2": second}))
    assert not both.found and "psm1" in both.reason and "psm2" in both.reason
    going = plan_motion(MotionProblem({"psm2": second})).trajectory
    for begins_s, meet in ((0.0, True), (-10.0, True), (10.0, True), (0.0, False)):
        under_way = MovingArm(PSM, going, RIGHT, begins_s)  # it rests where it starts and where it ends
        aside = MovingArm(PSM, going, RIGHT @ SE3.from_parts(translation_m=(0.3, 0, 0)), begins_s)
        others = {"psm2": under_way if meet else aside}
        assert plan_motion(MotionProblem({"psm1": first}, others=others)).found is not meet


def test_arms_that_are_not_asked_may_be_where_they_are():
    resting = MovingArm.resting(PSM, ASIDE_RIGHT.waypoints[0], RIGHT)
    inside = {"fog": Capsule(RIGHT.apply(fk(PSM, ASIDE_RIGHT.waypoints[0]).translation_m), radius_m=0.01)}
    assert plan_motion(MotionProblem({"psm1": ASIDE_LEFT}, others={"psm2": resting}, obstacles=inside)).found


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda path: {}, r"planner '<lambda>' returned paths for \[\]; it was asked for \['psm1'\]"),
        (lambda path: 3, "planner '<lambda>' returned 3; it must return a TimedPath for each arm"),
        (lambda path: {"psm1": path.trajectory}, "it must return a TimedPath for each arm"),
    ],
)
def test_a_malformed_answer_is_an_error(answer, words):
    with pytest.raises(TrocarError, match=words):
        plan_motion(asking(), lambda problem: answer(stops(problem)["psm1"]))


def test_a_planner_that_finds_nothing_says_why():
    @ignores(Demand.DISTANCES)
    def helpless(problem):
        raise TrocarError("nothing came to mind")

    plan = plan_motion(asking(), helpless)
    assert not plan.found and not plan.paths and np.isnan(plan.duration_s)
    assert plan.reason == "planner 'helpless' found no motion: nothing came to mind"
    assert isinstance(plan.refusal, NoPlan) and plan.refusal.planner == "helpless"
    assert plan.bound_s > 0
    assert repr(plan) == f"<no MotionPlan: {plan.reason}>"


def test_a_refusal_by_a_planner_keeps_its_type_and_fields():
    def busy(problem):
        raise ArmMoving("psm1")

    plan = plan_motion(asking(), busy)
    assert isinstance(plan.refusal, ArmMoving) and plan.refusal.arm == "psm1"
    assert plan.reason.startswith("planner 'busy' found no motion: arm 'psm1' is already moving")


def test_an_unknown_planner_is_refused():
    with pytest.raises(TrocarError, match="planner 'magic' is unknown; choose one of spline"):
        plan_through(PSM, FOUR, PAPER, planner="magic")


def test_sugar_asks_the_same():
    start = np.array([0.1, 0, 0, 0, 0, 0])
    plan = plan_through(PSM, FOUR, PAPER, up=[0, 0, 2], start_velocity=start)
    same = plan_motion(asking(ArmMotion(PSM, FOUR, PAPER, start_velocity=start)))
    np.testing.assert_array_equal(plan.trajectory.coefficients, same.trajectory.coefficients)
    assert plan.bound_s == same.bound_s


def test_more_waypoints_than_four_and_a_descent_of_one_arm():
    places = [[-0.05, 0, 0], [-0.05, 0, 0.02], [-0.03, 0.01, 0.03], [-0.02, 0, 0.02], [-0.02, 0, 0]]
    assert plan_motion(MotionProblem({"psm1": over_the_table(LEFT, places)})).found
