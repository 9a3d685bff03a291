from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ravens import KEPT_M, NAMES, STATION, asked, down, joints, least_m, random_waypoints, swapping
from trocar.arms import fk
from trocar.errors import ArmMoving, TooNear, TrocarError
from trocar.geometry import SE3
from trocar.motion import Capsule, Facing, MovingArm, open_box, plan_motion
from trocar.motion.check import tip_speeds_m_s
from trocar.motion.convex import require_possible, search
from trocar.motion.convex.scene import Scene
from trocar.motion.convex.search import Search
from trocar.trajectory import Trajectory

SEEDS = st.integers(0, 2**32 - 1)
PLACE = SE3.from_parts(translation_m=[-0.03, 0.01, -0.162])  # its wall at x = -87 mm
RECEPTACLE = open_box("box", PLACE, inside_m=(0.11, 0.07), height_m=0.02, radius_m=2e-3)


ACROSS = swapping(0.01)
"""Two tips that trade places along x, one in front of the other: the straight line collides, there is a way."""


def straight_m(problem):
    ends = [np.concatenate([arm.waypoints[i] for arm in problem.arms.values()]) for i in (0, -1)]
    line = {
        name: lambda t, k=k: (ends[0] + t[:, None] * (ends[1] - ends[0]))[:, 6 * k : 6 * k + 6]
        for k, name in enumerate(NAMES)
    }
    return least_m(problem, line, 1.0)


def test_two_arms_find_a_way_where_the_straight_line_collides():
    problem = asked(ACROSS)
    assert straight_m(problem) < -3e-3
    plan = plan_motion(problem, "convex")
    assert plan.found, plan.reason
    assert least_m(problem, plan.trajectories, plan.duration_s) > KEPT_M - 1e-5
    for name, arm in problem.arms.items():
        np.testing.assert_allclose(plan.trajectories[name](plan.duration_s), arm.waypoints[-1], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, slow=st.booleans())
def test_what_is_answered_never_collides_and_keeps_limits_speed_and_marks(seed, slow):
    """Sampled here by other means than the check's; both arms over a table, jaws open."""
    rng = np.random.default_rng(seed)
    limit = 0.05 if slow else np.inf
    problem = asked(random_waypoints(rng), rng.uniform(0, 1.2, 2), max_rad=1.45, max_tip_m_s=limit)
    plan = plan_motion(problem, "convex")
    if not plan.found:
        assert "infeasible: " in plan.reason or "not found: " in plan.reason
        return
    assert least_m(problem, plan.trajectories, plan.duration_s) > KEPT_M - 1e-5
    times = np.linspace(0, plan.duration_s, 2001)[:-1]
    for name, arm in problem.arms.items():
        motion = plan.trajectories[name]
        q, v, a = (motion(times, order) for order in range(3))
        assert np.all(np.abs(v) <= arm.limits.velocity * (1 + 1e-9))
        assert np.all(np.abs(a) <= arm.limits.acceleration * (1 + 1e-9))
        assert np.all(q >= arm.model.lower - 1e-9) and np.all(q <= arm.model.upper + 1e-9)
        tips = fk(arm.model, q)
        steps = np.linalg.norm(np.diff(tips.translation_m, axis=0), axis=1) / times[1]
        assert steps.max() <= limit * (1 + 1e-6)
        assert tip_speeds_m_s(arm, q, v).max() <= limit * (1 + 1e-6)
        assert arm.facing.angle_rad(arm.T_world_base @ tips).max() <= arm.facing.max_rad + 1e-9


def test_the_limit_that_binds_is_used():
    still = asked(swapping(0.03), max_tip_m_s=0.01)
    plan = plan_motion(still, "convex")
    arm = still.arms["left"]
    times = np.linspace(0, plan.duration_s, 1000)
    speeds = [tip_speeds_m_s(arm, plan.trajectories[n](times), plan.trajectories[n](times, 1)) for n in NAMES]
    assert max(s.max() for s in speeds) > 0.0099
    assert np.median(np.max(speeds, axis=0)) > 0.0097  # nearly all the way, not once
    fast = plan_motion(
        replace(still, arms={n: replace(a, max_tip_m_s=np.inf) for n, a in still.arms.items()}), "convex"
    )
    assert max(use.acceleration_ratio for use in fast.use.values()) > 0.98
    assert fast.duration_s < plan.duration_s / 2


def test_marks_are_kept_in_view_where_the_plain_path_turns_them_away():
    arm = STATION.arms["left"]
    ends = np.array([joints("left", down([-0.09, 0.0, -0.12], turn)) for turn in (-1.0, 1.0)])
    free = asked(np.array([ends, [joints("right", down([-0.13, y, -0.12])) for y in (0.0, 0.01)]]))
    middle = free.arms["left"].waypoints.mean(axis=0)
    tip = arm.T_world_base @ fk(arm.model, middle)
    axis = np.array([0.0, -0.2, -1.0])  # where the tip faces this point least in the middle of the way
    aside = Facing(axis, tip.apply(np.array([0.12, 0.0, 0.1])), np.pi)
    angles = [float(aside.angle_rad(arm.T_world_base @ fk(arm.model, q))) for q in (*ends, middle)]
    limit = (max(angles[:2]) + angles[2]) / 2
    assert angles[2] > limit > max(angles[:2])
    arms = {"left": replace(free.arms["left"], facing=replace(aside, max_rad=limit)), "right": free.arms["right"]}
    assert not plan_motion(replace(free, arms=arms), "optimal").found
    plan = plan_motion(replace(free, arms=arms), "convex")
    assert plan.found, plan.reason
    q = plan.trajectories["left"](np.linspace(0, plan.duration_s, 2000))
    assert aside.angle_rad(arm.T_world_base @ fk(arm.model, q)).max() <= limit + 1e-9


def test_waypoints_on_the_way_are_passed_exactly_and_without_a_stop():
    heights = (-0.10, -0.12, -0.145)
    over = [[-0.03, 0.02], [-0.06, 0.0], [-0.06, 0.0]]
    left = [joints("left", down([*xy, z])) for xy, z in zip(over, heights, strict=True)]
    right = [joints("right", down([-0.12, -0.03, z])) for z in (-0.11, -0.12)]
    problem = asked([left, right], obstacles=RECEPTACLE)
    plan = plan_motion(problem, "convex")
    assert plan.found, plan.reason
    when = plan.waypoint_times_s["left"]
    np.testing.assert_allclose(plan.trajectories["left"](when), left, atol=1e-7)
    assert np.abs(plan.trajectories["left"](when[1], 1)).max() > 0.01


def test_one_arm_goes_over_the_wall_of_a_receptacle():
    ends = [joints("left", down([x, 0.01, -0.142])) for x in (-0.04, -0.11)]
    one = asked([ends, ends], obstacles=RECEPTACLE)
    problem = replace(one, arms={"left": one.arms["left"]})
    assert not plan_motion(problem, "optimal").found
    plan = plan_motion(problem, "convex")
    assert plan.found, plan.reason
    heights = fk(problem.arms["left"].model, plan.trajectory(np.linspace(0, plan.duration_s, 200)))
    top = (problem.arms["left"].T_world_base @ heights).translation_m[:, 2].max()
    assert top > -0.142 + 0.008


def test_an_arm_that_is_not_asked_is_kept_clear_of_whether_it_rests_or_moves():
    both = asked(ACROSS)
    left, right = both.arms["left"], both.arms["right"]
    alone = plan_motion(replace(both, arms={"right": right}), "convex")
    moving = MovingArm(right.model, alone.trajectory, right.T_world_base, jaw_rad=right.jaw_rad)
    problem = replace(both, arms={"left": left}, others={"right": moving})
    plan = plan_motion(problem, "convex")
    assert plan.found, plan.reason
    last = max(plan.duration_s, moving.end_s)
    assert least_m(problem, {"left": plan.trajectory}, last) > KEPT_M - 1e-5
    resting = MovingArm.resting(right.model, right.waypoints[0], right.T_world_base, right.jaw_rad)
    blocked = plan_motion(replace(problem, others={"right": resting}), "convex")
    assert blocked.found or "infeasible: at the end" in blocked.reason


def test_what_cannot_be_is_told_apart_from_what_was_not_found():
    problem = asked(ACROSS)
    end = problem.arms["left"].T_world_base @ fk(problem.arms["left"].model, problem.arms["left"].waypoints[-1])
    ball = {"ball": Capsule(end.translation_m, radius_m=3e-3)}
    alone = replace(problem, arms={"left": problem.arms["left"]}, obstacles=ball)
    near = plan_motion(alone, "convex").refusal
    assert "infeasible: at the end, left" in str(near) and "from ball, not 1.00 mm; move the end" in str(near)
    assert isinstance(near, TooNear) and near.first.startswith("left") and near.second == "ball"
    assert near.arms == ("left",) and not near.at_start and near.distance_m < near.required_m == 1e-3


def test_where_no_start_leads_to_a_motion_that_is_said(monkeypatch):
    monkeypatch.setattr(Search, "followed", lambda self, control, effort: None)
    plan = plan_motion(asked(ACROSS), "convex")
    assert "found no motion: not found: no start led to a motion that keeps all distances" in plan.reason


def test_an_inner_waypoint_in_a_wall_is_infeasible():
    left = [joints("left", down([x, 0.01, z])) for x, z in ((-0.06, -0.12), (-0.087, -0.145), (-0.09, -0.12))]
    one = asked([left, left], obstacles=RECEPTACLE)
    reason = plan_motion(replace(one, arms={"left": one.arms["left"]}), "convex").reason
    assert "infeasible: at waypoint 1, left" in reason and "from box" in reason


def test_a_moving_start_is_refused_in_one_sentence():
    problem = asked(ACROSS)
    moving = replace(problem.arms["left"], start_velocity=np.full(6, 1e-3))
    refusal = plan_motion(replace(problem, arms={**problem.arms, "left": moving}), "convex").refusal
    assert isinstance(refusal, ArmMoving) and refusal.arm == "left"
    assert "'left' is already moving; 'convex' plans from rest" in str(refusal)


def test_the_same_question_has_the_same_answer():
    plans = [plan_motion(asked(ACROSS), "convex") for _ in range(2)]
    for name in NAMES:
        np.testing.assert_array_equal(*(plan.trajectories[name].coefficients for plan in plans))


def test_a_way_that_leads_far_round_is_shortened(monkeypatch):
    rng = np.random.default_rng(4)
    problems = [asked(random_waypoints(rng), (1.0, 1.0)) for _ in range(25)]
    seconds = {}
    for steps in (0, search.SHORTER):
        monkeypatch.setattr(search, "SHORTER", steps)
        seconds[steps] = [plan.duration_s for plan in (plan_motion(p, "convex") for p in problems) if plan.found]
    first, shortened = (np.array(found) for found in seconds.values())
    assert len(first) == len(shortened) > 12
    assert (shortened < 1.02 * first).all()
    assert (shortened < 0.9 * first).any()


def test_the_place_and_the_pair_that_is_too_near_are_named():
    tips_m = [-0.03, 0.02, -0.10], [-0.05, 0.01, -0.11], [-0.06, 0.0, -0.12], [-0.04, 0.02, -0.11]
    left = [joints("left", down(tip)) for tip in tips_m]
    right = [joints("right", down([-0.12, -0.03, z])) for z in (-0.11, -0.12)]
    problem = asked([left, right])
    arm = problem.arms["left"]
    tips = (arm.T_world_base @ fk(arm.model, arm.waypoints)).translation_m
    for index, words in (
        (0, r"at the start, left .* is .* mm from ball, not 1.00 mm; move the start"),
        (1, r"at waypoint 1, left .* from ball, not 1.00 mm; move waypoint"),
        (2, r"at waypoint 2, left .* from ball, not 1.00 mm; move waypoint"),
        (3, r"at the end, left .* is .* mm from ball, not 1.00 mm; move the end"),
    ):
        there = replace(problem, obstacles={"far": Capsule([1.0, 0, 0]), "ball": Capsule(tips[index], radius_m=1e-3)})
        with pytest.raises(TrocarError, match=words):
            require_possible(there, Scene.of(there))
    require_possible(problem, Scene.of(problem))


@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_start_may_stand_exactly_as_near_as_is_allowed(index):
    left = [joints("left", down(tip)) for tip in ([-0.03, 0.02, -0.10], [-0.05, 0.01, -0.11], [-0.06, 0.0, -0.12])]
    problem = asked([left, left])
    arm = problem.arms["left"]
    tip = (arm.T_world_base @ fk(arm.model, arm.waypoints[index])).translation_m
    alone = replace(problem, arms={"left": arm}, obstacles={"ball": Capsule(tip - [0, 0, 0.02], radius_m=1e-3)})
    near_m = Scene.of(alone).distances(arm.waypoints, np.zeros(3)).distance_m[index].min()
    for more_m, possible in ((0.5e-9, True), (1.5e-9, False)):
        asking = replace(alone, min_distance_m=near_m + more_m)
        if Scene.of(alone).distances(arm.waypoints, np.zeros(3)).distance_m.min() < near_m:
            continue  # another waypoint is nearer still
        if possible:
            require_possible(asking, Scene.of(asking))
        else:
            with pytest.raises(TrocarError, match="infeasible: at"):
                require_possible(asking, Scene.of(asking))


def test_where_others_rest_counts_at_the_end_and_where_they_start_at_the_start():
    problem = asked(swapping(0.0))
    arm, right = problem.arms["left"], problem.arms["right"]
    away = joints("right", down([-0.14, -0.04, -0.12]))
    meets = right.waypoints[::-1]  # where the left tip starts and ends
    for ends, where in (([meets[0], away], "start"), ([away, meets[1]], "end"), ([away, 0.9 * away], None)):
        motion = Trajectory.hermite([0.0, 1.0], np.array(ends), np.zeros((2, 6)))
        other = MovingArm(right.model, motion, right.T_world_base)
        beside = replace(problem, arms={"left": arm}, others={"other": other}, obstacles={})
        if where is None:
            require_possible(beside, Scene.of(beside))
        else:
            with pytest.raises(TrocarError, match=f"at the {where}, left"):
                require_possible(beside, Scene.of(beside))


def test_the_waypoint_that_faces_aside_most_is_named_and_its_angle():
    left = [joints("left", down(tip, turn)) for tip, turn in (([-0.03, 0.02, -0.10], 0.0), ([-0.06, 0.0, -0.12], 0.3))]
    facing = Facing([0.0, 1.0, 0.0], [-0.05, 0.5, -0.12], 3.0)
    arm = replace(asked([left, left]).arms["left"], facing=facing)
    angles = facing.angle_rad(arm.T_world_base @ fk(arm.model, arm.waypoints))
    assert abs(angles[0] - angles[1]) > 0.1
    for off, possible in ((0.5e-9, True), (1.5e-9, False)):
        limited = replace(arm, facing=replace(facing, max_rad=float(angles.max()) - off))
        problem = replace(asked([left, left]), arms={"left": limited})
        if possible:
            require_possible(problem, Scene.of(problem))
        else:
            words = (
                f"infeasible: at waypoint {np.argmax(angles)} the tip of 'left' faces {angles.max():.3f} rad aside, not"
            )
            with pytest.raises(TrocarError, match=words):
                require_possible(problem, Scene.of(problem))
