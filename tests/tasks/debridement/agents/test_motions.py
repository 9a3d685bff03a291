"""How motions of two arms are planned and run, and what becomes of refusals: a scripted planner and robot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trio
from trio.testing import MockClock

from driven import ARM, HOME, PAPER
from trocar.arms import fk
from trocar.cell import MotionEnd, MotionResult
from trocar.errors import AlreadyThere, ArmStopped, InvalidInput, LimitExceeded, NoPlan, TooNear
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.log import CellLog
from trocar.motion import rest_to_rest
from trocar.robots.coordinator import Coordinator
from trocar.tasks.debridement.agents.adjusted import StepEnded
from trocar.tasks.debridement.agents.motions import MotionProblems, MotionRunner, NoMotion, TipGoal, near_another_arm
from trocar.tasks.debridement.agents.settings import best, paper
from trocar.tasks.debridement.goals import Workspace

GOAL = TipGoal(SE3.identity(), 0.05)
ARMS = {"left": ARM, "right": ARM}
SHORT, LONG = (rest_to_rest(HOME, HOME + [0.0, 0.0, by_m, 0, 0, 0], PAPER) for by_m in (0.01, 0.06))


def too_near(*arms, at_start=False):
    words = {"first": "left right finger", "second": "right left finger", "distance_m": 0.0, "required_m": 1e-3}
    return TooNear("left right finger is near", arms=arms, at_start=at_start, **words)


class Stage:
    """A runner whose plans and motions end as a test says; it notes what was planned, sent and held.

    Attributes:
        plans: a motion or a refusal by the arms that a plan is for.
        ends: by arm, how its motion ends; a refusal if it does not start.
    """

    def __init__(self, settings):
        self.plans, self.ends, self.planned, self.sent, self.learned = {}, {}, [], {}, []
        self.log = CellLog(trio.current_time)
        bases = dict.fromkeys(ARMS, SE3.identity())
        self.cell = SimpleNamespace(
            arms=ARMS, T_world_base_registered=bases, log=self.log, clock=self, compute=self.compute
        )
        problems = SimpleNamespace(cell=self.cell, robot=self, settings=settings)
        self.coordinator = Coordinator(self.cell, tuple(ARMS))
        self.runner = MotionRunner(problems, self.coordinator, None)
        self.runner._plan = self.plan

    async def compute(self, arm, name, function, budget_s):
        await trio.sleep(budget_s)
        return function()

    async def sleep(self, seconds):
        await trio.sleep(seconds)

    def plan(self, goals):
        self.planned.append(tuple(goals))
        found = self.plans[tuple(sorted(goals))]
        if isinstance(found, dict):
            return SimpleNamespace(found=True, trajectories=found, refusal=None)
        return SimpleNamespace(found=False, trajectories={}, refusal=found)

    async def move(self, motions, stop_s):
        ((arm, motion),) = motions.items()
        end = self.ends.get(arm)
        if isinstance(end, Exception):
            raise end
        self.sent[arm] = trio.current_time(), motion, stop_s
        self.held = trio.Event()
        self.reason = end.cause if end else None
        with trio.move_on_after(motion.duration_s):
            await self.held.wait()
        return {arm: end or MotionResult.not_started(MotionEnd.HELD if self.reason else MotionEnd.DONE, self.reason)}

    def setpoint(self, arm):
        return SimpleNamespace(moving=arm in self.sent)

    def to_stop_s(self, arm):
        begin_s, _, stop_s = self.sent[arm]
        return begin_s + stop_s - trio.current_time()

    def hold(self, arm, reason):
        self.reason = reason
        self.held.set()

    def keep(self, *arms):
        pass

    def learn(self, *arms):
        self.learned += arms


def run(settings, script):
    async def main():
        stage = Stage(settings)
        await script(stage)
        return stage

    return trio.run(main, clock=MockClock(autojump_threshold=0))


@pytest.mark.parametrize(
    ("refusal", "lasting", "begins_too_near", "at_another_arm"),
    [
        (too_near("left"), True, False, False),
        (too_near("left", at_start=True), True, True, False),
        (too_near("left", "right"), False, False, True),
        (too_near("left", "right", at_start=True), False, True, True),
        (NoPlan("left comes within 1 mm of right left finger at the start"), True, False, False),
    ],
)
def test_what_to_do_without_a_plan_is_told_by_what_is_in_the_way(refusal, lasting, begins_too_near, at_another_arm):
    """Arms and fingers are both called left and right; an arm at the receptacle's wall would go aside, not up."""

    async def script(stage):
        stage.plans["left",] = refusal
        with pytest.raises(NoMotion) as refused:
            await stage.runner.step("left", GOAL)
        error = refused.value
        found = error.lasting, error.begins_too_near, near_another_arm("left", error.cause)
        assert found == (lasting, begins_too_near, at_another_arm)
        assert stage.learned == ["left"] and not stage.sent
        assert [event["reason"] for event in stage.log.events] == [str(refusal)]

    run(best(), script)


def result(ended, cause):
    return MotionResult.not_started(ended, cause)


@pytest.mark.parametrize(
    ("end", "raised", "lasting"),
    [
        (too_near("left", "right"), NoMotion, False),
        (LimitExceeded("too fast", arm="left"), NoMotion, True),
        (result(MotionEnd.FAULT, too_near("left", "right")), NoMotion, False),
        (result(MotionEnd.FAULT, ArmStopped("left", "left comes within reach of nobody")), ArmStopped, None),
        (result(MotionEnd.HELD, ArmStopped("left", "a step of the way is done")), ArmStopped, None),
        (result(MotionEnd.HELD, StepEnded("left")), None, None),
        (result(MotionEnd.DONE, None), None, None),
    ],
)
def test_how_a_motion_ended_is_told_by_its_type(end, raised, lasting):
    async def script(stage):
        stage.ends["left"] = end
        if raised is None:
            return await stage.runner.run("left", SHORT)
        with pytest.raises(raised) as error:
            await stage.runner.run("left", SHORT)
        assert type(error.value) is raised
        if lasting is not None:
            assert error.value.lasting == lasting

    run(best(), script)


def test_an_arm_that_is_there_already_does_nothing():
    async def script(stage):
        stage.plans["left",] = AlreadyThere("start and goal coincide")
        await stage.runner.step("left", GOAL)
        assert not stage.sent and not stage.log.events

    run(best(), script)


def test_arms_that_plan_one_beside_the_other_plan_in_turn_and_stop_after_a_step():
    async def script(stage):
        stage.plans |= {("left",): {"left": LONG}, ("right",): {"right": SHORT}}
        async with trio.open_nursery() as nursery:
            for name in ARMS:
                nursery.start_soon(stage.runner.step, name, GOAL)
        budget_s = best().plan_budget_s
        assert sorted(begin for begin, _, _ in stage.sent.values()) == pytest.approx([budget_s, 2 * budget_s])
        assert stage.sent["left"][2] is None, "6 cm are less than a step"

    run(best(), script)


def test_arms_that_plan_together_start_together_and_stop_when_the_first_has_gone_a_step():
    async def script(stage):
        stage.plans["left", "right"] = {"left": LONG, "right": SHORT}
        async with trio.open_nursery() as nursery:
            nursery.start_soon(stage.runner.step, "left", GOAL)
            await trio.sleep(1.0)
            assert not stage.planned
            nursery.start_soon(stage.runner.step, "right", GOAL)
        assert stage.planned == [("left", "right")]
        (left_s, _, left_stop_s), (right_s, _, right_stop_s) = stage.sent["left"], stage.sent["right"]
        assert left_s == right_s == pytest.approx(1.0 + paper().plan_budget_s)
        assert left_stop_s == right_stop_s and 0.0 < left_stop_s < LONG.duration_s
        times, q = LONG.sample(0.01)
        gone_m = np.interp(left_stop_s, times, np.abs(q[:, 2] - q[0, 2]))
        assert gone_m == pytest.approx(paper().step_m, abs=4e-3)

    run(paper(), script)


def test_arms_that_find_no_plan_together_move_one_after_the_other_in_turn():
    moved = []

    async def script(stage):
        stage.plans |= {("left", "right"): NoPlan("no"), ("left",): {"left": SHORT}, ("right",): {"right": SHORT}}

        async def go(name):
            try:
                await stage.runner.step(name, GOAL)
                moved.append(name)
            except NoMotion as error:
                assert not error.lasting, "its turn comes"

        for _ in range(2):
            async with trio.open_nursery() as nursery:
                for name in ARMS:
                    nursery.start_soon(go, name)
        assert sorted(moved) == ["left", "right"]

    run(paper(), script)


STATION = load_station("raven-pair")
STATION = replace(STATION, arms={k: replace(arm, limits=arm.limits.slowed(0.9)) for k, arm in STATION.arms.items()})
PARKED = {name: arm.park_q() for name, arm in STATION.arms.items()}


def problems(course=None):
    """Problems of the station's arms, which rest where they are parked; or the right one is on a course."""
    cell = SimpleNamespace(
        arms=STATION.models,
        limits=STATION.limits,
        T_world_base_registered={name: arm.T_world_base for name, arm in STATION.arms.items()},
        T_world_camera_registered={"stereo": STATION.cameras["stereo"].T_world_camera},
        T_world_fixture=STATION.T_world_fixture,
        clock=SimpleNamespace(now_s=lambda: 10.0),
    )
    robot = SimpleNamespace(
        setpoint=lambda name: SimpleNamespace(q=PARKED[name], path_s=0.5),
        read=lambda name: SimpleNamespace(jaw_rad=0.3),
        course=lambda name: course,
    )
    return MotionProblems(cell, robot, Workspace(), best())


def tip(name, by_m=(0.0, 0.0, 0.0)):
    arm = STATION.arms[name]
    T_world_tip = arm.T_world_base @ fk(arm.model, PARKED[name])
    return SE3.from_parts(T_world_tip.rotation, T_world_tip.translation_m + by_m)


@pytest.mark.parametrize(("straight", "obstacles"), [(False, True), (True, False)])
def test_fixtures_are_in_the_way_unless_an_arm_goes_straight_down_to_a_fragment(straight, obstacles):
    goals = {name: TipGoal(tip(name, (0.0, 0.0, -0.01)), 0.05) for name in PARKED}
    goals["left"] = replace(goals["left"], straight=straight)
    both = problems().of(goals, 0.0)
    assert bool(both.obstacles) == obstacles and not both.others and set(both.arms) == set(PARKED)
    alone = problems().of({"right": goals["right"]}, 0.0)
    assert "table" in alone.obstacles and set(alone.others) == {"left"}
    assert alone.min_distance_m == best().margin_m and alone.arms["right"].max_tip_m_s == 0.05
    for name, arm in both.arms.items():
        np.testing.assert_array_equal(arm.limits.velocity, best().limits_share * STATION.limits[name].velocity)


def test_walls_are_higher_for_an_arm_that_carries_something_past_them():
    def top_m(beside_wall):
        walls = problems().obstacles(beside_wall)
        return max(part.end_m[2] for name, part in walls.items() if name.startswith("receptacle"))

    assert top_m(False) - top_m(True) == pytest.approx(best().hanging_m)


def test_another_arm_is_where_it_is_commanded_now_and_goes_on_from_there():
    motion = rest_to_rest(PARKED["right"], PARKED["right"] + [0.1, 0, 0, 0, 0, 0], PAPER)
    other = problems((motion, 9.5)).of({"left": TipGoal(tip("left", (0, 0, -0.01)), 0.05)}, 0.2).others["right"]
    assert other.start_s == pytest.approx(9.5 - 10.0 - 0.2)
    np.testing.assert_allclose(other.joints(-0.2), PARKED["right"], atol=1e-12)
    np.testing.assert_allclose(other.joints(0.1) - other.joints(-0.2), motion(0.8) - motion(0.5), atol=1e-12)


def test_a_planner_that_finds_nothing_refuses_but_one_that_answers_wrongly_is_an_error():
    def finds_nothing(problem):
        raise NoPlan("no way round")

    goals = {"left": TipGoal(tip("left", (0, 0, -0.01)), 0.05)}
    assert isinstance(MotionRunner(problems(), None, finds_nothing)._plan(goals).refusal, NoPlan)
    with pytest.raises(InvalidInput, match="returned paths for"):
        MotionRunner(problems(), None, lambda problem: {})._plan(goals)
