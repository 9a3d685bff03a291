"""One arm's actions, with a fake robot and runner that only answer and record."""

from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import trio
from trio.testing import MockClock

from debridement_stage import Eyes, play
from trocar.arms import fk
from trocar.cell import MotionEnd
from trocar.errors import ArmStopped, NoPlan, TooNear, TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.tasks.debridement.agents.adjusted import StepEnded
from trocar.tasks.debridement.agents.motions import NoMotion, TipGoal
from trocar.tasks.debridement.agents.places import Grasp, Places, raised
from trocar.tasks.debridement.agents.raven_arm import (
    FEW,
    IN_VAIN,
    LOW_M,
    PRESSING,
    RISE_SHARES,
    SEARCH,
    SHAKEN_RAD,
    STROKES,
    TRIES,
    WAYS,
    RavenArm,
)
from trocar.tasks.debridement.agents.settings import best

STATION = load_station("raven-pair")
TABLE, RECEPTACLE = (STATION.T_world_fixture[name] for name in ("table", "receptacle"))


class Runner:
    """Brings the tip where each step of a list says, or refuses as it says, and notes what it was to do."""

    def __init__(self, robot, steps):
        self.robot, self.steps, self.goals, self.motions = robot, list(steps), [], []

    async def step(self, arm, goal):
        del arm
        self.goals.append(goal)
        step = self.steps.pop(0)
        if isinstance(step, Exception):
            raise step
        self.robot.p = np.array(step)

    async def run(self, arm, motion):
        del arm
        self.motions.append(motion)


def raven_arm(p, steps, name="left", observer=None):
    robot = SimpleNamespace(p=np.array(p), T_world_tip=lambda _: SE3.from_parts(translation_m=robot.p))
    arm = STATION.arms[name]
    cell = SimpleNamespace(arms={name: arm.model}, T_world_base_registered={name: arm.T_world_base})
    cell.limits = STATION.limits
    cell.log, cell.clock = SimpleNamespace(span=lambda *_: nullcontext()), SimpleNamespace(sleep=trio.sleep)
    runner = Runner(robot, steps)
    runner.problems = SimpleNamespace(cell=cell, robot=robot)
    return RavenArm(name, observer, runner, Places(TABLE, RECEPTACLE, best()), best()), runner


def test_an_arm_that_was_stopped_low_on_its_way_rises_before_it_goes_on():
    table = float(TABLE.translation_m[2])
    low, risen, high = table + 0.5 * LOW_M, table + LOW_M, table + 0.03
    arm, runner = raven_arm([0, 0, high], [[0.02, 0, low], [0.02, 0, risen], [0.04, 0, high]])
    trio.run(arm.go, SE3.from_parts(translation_m=[0.04, 0.0, high]))
    assert [goal.straight for goal in runner.goals] == [False, True, False]
    np.testing.assert_allclose(runner.goals[1].T_world_tip.translation_m, [0.02, 0.0, risen])


@pytest.mark.parametrize("seen_at", [0, 4, None])
@pytest.mark.parametrize(("name", "towards_the_other"), [("left", -1), ("right", 1)])
def test_an_arm_that_no_camera_sees_looks_for_itself_and_stops_if_it_is_nowhere(name, towards_the_other, seen_at):
    start = np.array([0.01, -0.06, -0.08])
    steps = [NoMotion(name, NoPlan("no way")), *[start] * (len(SEARCH) - 1)] if seen_at is None else [start] * 10

    class Observer:
        looks = 0

        async def observe(self, arm):
            assert arm == name
            self.looks += 1

    observer = Observer()
    arm, runner = raven_arm(start, steps, name, observer)
    seen = 1 if seen_at is None else seen_at + 1
    arm.robot.age_s = lambda _: np.inf if seen_at is None or observer.looks < seen else 0.2
    if seen_at is None:
        with pytest.raises(ArmStopped, match=f"no camera sees the gripper of arm '{name}'"):
            trio.run(arm.come_into_sight)
        assert observer.looks == len(SEARCH) - 1, "where it found no way it did not look"
    else:
        trio.run(arm.come_into_sight)
        assert observer.looks == len(runner.goals) == seen
    shifts = np.array([goal.T_world_tip.translation_m - start for goal in runner.goals])
    np.testing.assert_allclose(shifts[0], 0.0, atol=1e-12)
    assert (shifts[1:3, 2] < 0.0).all(), "down first"
    assert (np.sign(shifts[2:4, 0]) == towards_the_other).all(), "then towards the middle"
    leans = [goal.T_world_tip.rotation.log() for goal in runner.goals]
    np.testing.assert_allclose([lean for _, lean in SEARCH[: len(leans)]], [lean[0] for lean in leans], atol=1e-12)
    assert len(leans) < 4 or SE3.from_parts(SO3.exp(leans[3])).apply([0.0, 1.0, 0.0])[2] > 0.4, "marks face up"


def grasp_at(p_m):
    down = SE3.from_parts(translation_m=p_m)
    return Grasp(raised(down, best().above_m), down, 1.0, 0)


LOW = np.array([-0.05, -0.07, -0.148])
"""A grasp."""


def approached(*steps, been_down=True, age_s=0.1):
    """Return the goals of an arm that approaches a grasp at ``LOW``, and comes to be here after each step."""
    arm, runner = raven_arm([-0.05, 0.0, -0.12], steps)
    arm.problems.clear, arm.robot.age_s, arm._been_down = lambda *_, **__: True, lambda _: age_s, been_down
    trio.run(arm._approach, grasp_at(LOW), clock=MockClock(autojump_threshold=0))
    return [(goal.T_world_tip.translation_m.tolist(), len(goal.T_world_through)) for goal in runner.goals]


def test_an_arm_that_knows_the_place_passes_the_one_above_it_without_a_stop():
    above = (LOW + [0.0, 0.0, best().above_m]).tolist()
    assert approached(LOW) == [(LOW.tolist(), 1)]
    assert approached(above, been_down=False) == [(above, 0)], "errors near the surface are not known yet"
    assert approached(above, age_s=2 * best().fresh_s) == [(above, 0)], "nobody has seen it"


def test_an_arm_that_was_stopped_on_its_way_down_or_finds_no_such_path_first_goes_to_the_place_above():
    above = (LOW + [0.0, 0.0, best().above_m]).tolist()
    half_way = LOW + [0.0, 0.03, 0.02]
    assert approached(half_way, above) == [(LOW.tolist(), 1), (above, 0)]
    no_way = NoMotion("left", NoPlan("no way"), lasting=True)
    assert approached(no_way, above) == [(LOW.tolist(), 1), (above, 0)]


def test_jaws_that_stop_because_the_arm_plans_again_go_on_and_those_that_get_another_goal_do_not():
    arm, _ = raven_arm(HIGH, [])
    arm.model = STATION.arms["left"].model
    arm.robot.read = lambda _: SimpleNamespace(jaw_rad=0.2)
    held, done = MotionEnd.HELD, MotionEnd.DONE
    ends = [(held, StepEnded("left")), (held, StepEnded("left")), (done, None)]
    asked = []

    async def jaw(_, angle_rad):
        asked.append(angle_rad)
        ended, cause = ends.pop(0)
        return SimpleNamespace(done=ended is done, ended=ended, cause=cause, reason=str(cause))

    arm.cell.robot = SimpleNamespace(jaw=jaw)
    trio.run(arm.jaw, 1.2, clock=MockClock(autojump_threshold=0))
    assert asked == [1.2] * 3
    ends[:] = [(MotionEnd.REPLACED, TrocarError("the jaws were given another target"))]
    trio.run(arm.jaw, 1.2, clock=MockClock(autojump_threshold=0))
    assert not ends, "another opening took over: the arm's own next one"
    ends[:] = [(MotionEnd.FAULT, TrocarError("the jaws do not answer"))]
    with pytest.raises(ArmStopped, match="do not answer"):
        trio.run(arm.jaw, 1.2, clock=MockClock(autojump_threshold=0))


HIGH = np.array([0.0, -0.06, -0.08])
"""A goal, well over the work surface."""


class Looking:
    """Counts looks."""

    def __init__(self):
        self.looks = 0

    async def track(self, _):
        self.looks += 1


def gone(*off_mm, **how):
    """Return the goals of the steps of an arm that goes to ``HIGH``, and comes to be this far off it after each."""
    arm, runner = raven_arm(HIGH + [0.05, 0, 0], [HIGH + 1e-3 * np.array(off) for off in off_mm], observer=Looking())
    trio.run(partial(arm.go, SE3.from_parts(translation_m=HIGH), **how))
    assert arm.observer.looks == (len(runner.goals) if how.get("precise") else 0), "only the camera makes it precise"
    return runner.goals


@pytest.mark.parametrize("sign", [-1, 1])
def test_an_arm_in_the_air_has_arrived_within_a_centimetre_and_lower_or_higher_by_six_millimetres(sign):
    assert len(gone((9.5 * sign, 9.5 * sign, 5.5 * sign))) == 1
    for off in ((10.5, 0, 0), (0, 10.5, 0), (0, 0, 6.5)):
        assert len(gone(sign * np.array(off), (0, 0, 0))) == 2


@pytest.mark.parametrize("sign", [-1, 1])
def test_an_arm_at_a_grasp_has_arrived_within_what_the_method_says_or_after_some_visits_close_to_it(sign):
    assert len(gone((2.4 * sign, 2.4 * sign, 1.2 * sign), precise=True)) == 1
    for off in ((2.6 * sign, 0, 0), (0, 2.6 * sign, 0), (0, 0, 1.8), (0, 0, -1.4)):
        assert len(gone(off, (0, 0, 0), precise=True)) == 2
    lowest_m = best().ends_above_m[0] - best().reached_low_m
    assert lowest_m > 0, "fingers that count as there do not stand on the work surface"
    assert best().close_m == 0.004 and best().max_visits == 2
    assert len(gone(*[(3.5 * sign, 0, 0)] * 3, precise=True)) == 3
    assert len(gone(*[(4.5 * sign, 0, 0)] * 3, (0, 0, 0), precise=True)) == 4


def test_a_correction_at_a_grasp_aims_further_because_play_takes_up_a_part_of_it():
    aims = [goal.T_world_tip.translation_m for goal in gone((1.8, -3.0, 1.5), (0, 0, 0), precise=True)]
    np.testing.assert_allclose(1e3 * (aims[1] - aims[0]), [-0.9, 1.0, -0.75], atol=1e-9)
    aims = [goal.T_world_tip.translation_m for goal in gone((15, 0, 0), (0, 0, 0))]
    np.testing.assert_allclose(aims[1], aims[0], atol=1e-12, err_msg="not on the way through the air")


def test_an_arm_that_may_be_there_already_looks_before_it_moves():
    assert len(gone((9, 0, 0), (0, 0, 0), precise=True)) == 2
    arm, runner = raven_arm(HIGH, [], observer=Looking())
    trio.run(partial(arm.go, SE3.from_parts(translation_m=HIGH + 1e-3), precise=True, looks_first=True))
    assert arm.observer.looks == 1 and not runner.goals


def test_an_arm_goes_no_further_if_whoever_sent_it_has_enough():
    assert len(gone((30, 0, 0), (0, 0, 0))) == 2
    assert len(gone((30, 0, 0), enough=lambda: True)) == 1


def test_an_arm_that_gets_no_nearer_gives_up_for_good():
    with pytest.raises(NoMotion, match="no nearer than 20 mm") as refused:
        gone(*[(20 + 0.5 * (number % 2), 0, 0) for number in range(1 + IN_VAIN)])
    assert refused.value.lasting
    slowly = [(40 - 1.5 * number, 0, 0) for number in range(20)]
    assert len(gone(*slowly, (9, 0, 0))) == 21, "slow progress is progress"


def test_fingers_that_stand_on_something_do_not_press_on():
    """Over a grasp, not beside it, nor on the way."""
    high = [(0, 0, 5)] * (1 + PRESSING)
    with pytest.raises(NoMotion, match="stand on something 5 mm over the grasp") as refused:
        gone(*high, precise=True, straight=True)
    assert not refused.value.lasting, "another grasp may do"
    for off in ((5, 0, 0), (0, 0, -5), (5, 0, 1.5)):
        assert len(gone(*[off] * (1 + PRESSING), (0, 0, 0), precise=True, straight=True)) == 2 + PRESSING
    assert len(gone(*[(0, 0, 7)] * (1 + PRESSING), (0, 0, 0), straight=True)) == 2 + PRESSING


@pytest.mark.parametrize(("lasting", "tries"), [(True, 1 + FEW), (False, TRIES)])
def test_an_arm_without_a_path_looks_and_asks_again_longer_if_the_other_one_may_move_off(lasting, tries):
    refusal = NoMotion("left", NoPlan("no way"), lasting=lasting)
    arm, runner = raven_arm(HIGH, [refusal] * (tries - 1) + [HIGH], observer=Looking())
    trio.run(arm.go, SE3.from_parts(translation_m=HIGH), clock=MockClock(autojump_threshold=0))
    assert arm.observer.looks == tries - 1
    arm, runner = raven_arm(HIGH, [refusal] * 99, observer=Looking())
    with pytest.raises(NoMotion) as raised:
        trio.run(arm.go, SE3.from_parts(translation_m=HIGH), clock=MockClock(autojump_threshold=0))
    assert len(runner.goals) == tries and raised.value is refusal


@pytest.mark.parametrize(
    ("at", "ways_mm"),
    [("right", [(6, 0, 0), (6, 0, 6), (0, 0, 6), (-6, 0, 0)]), ("receptacle", [(0, 0, 6), (6, 0, 6)])],
)
def test_an_arm_that_begins_too_near_to_something_first_moves_away_from_it(at, ways_mm):
    """From the other arm to its own side, from the receptacle upwards; another way if that is refused."""
    station = STATION.arms["left"]
    q, T_world_base = station.park_q(), station.T_world_base
    T_world_tip = T_world_base @ fk(station.model, q)
    arms = [name for name in ("left", at) if name in STATION.arms]
    bodies = {"first": "left finger", "second": at, "distance_m": 0.001, "required_m": 0.004}
    too_near = NoMotion("left", TooNear("too near", **bodies, arms=arms, at_start=True))
    arm, runner = raven_arm(T_world_tip.translation_m, [too_near, T_world_tip.translation_m], observer=Looking())
    arm.robot.T_world_tip, arm.robot.setpoint = lambda _: T_world_tip, lambda _: SimpleNamespace(q=q)
    moved_mm = []

    async def run(_, motion):
        ends = (T_world_base @ fk(station.model, motion(motion.times_s[[0, -1]]))).translation_m
        moved_mm.append(1e3 * (ends[1] - ends[0]))
        if len(moved_mm) < len(ways_mm):
            raise too_near

    runner.run = run
    trio.run(arm.go, T_world_tip)
    np.testing.assert_allclose(moved_mm, ways_mm, atol=1e-3)
    assert len(runner.goals) == 2, "then it asks again"


def test_a_grasp_is_possible_if_the_arm_reaches_it_and_the_place_above_and_can_lift_even_beside_a_wall():
    arm, _ = raven_arm(HIGH, [])
    at = SE3.from_parts(translation_m=HIGH)
    grasps = [Grasp(raised(at, 0.01), raised(at, 0.001 * number), 1.0, 0) for number in range(3)]
    arm.problems.clear = lambda name, T, open_rad, beside_wall: beside_wall
    for out in (grasps[0].T_world_above, grasps[0].T_world_grasp, raised(grasps[0].T_world_grasp, best().lift_m)):
        arm.robot.reaches = lambda _, T, out=out: abs(T.translation_m[2] - out.translation_m[2]) > 1e-9
        expected = None if out is grasps[0].T_world_above else grasps[1]
        assert arm.possible(grasps) is expected
    arm.robot.reaches = lambda *_: True
    arm.problems.clear = lambda *_, **__: False
    assert arm.possible(grasps) is None


@pytest.mark.parametrize(("lasting", "shares"), [(True, RISE_SHARES), (False, (1.0,))])
def test_an_arm_that_cannot_rise_so_far_rises_less_unless_something_is_merely_in_its_way(lasting, shares):
    refusal = NoMotion("left", NoPlan("no way"), lasting=lasting)
    arm, runner = raven_arm(HIGH, [refusal] * 999, observer=Looking())
    events = []
    arm.cell.log.event = lambda name, **_: events.append(name)
    rise = partial(trio.run, arm.rise, 0.02, clock=MockClock(autojump_threshold=0))
    if lasting:
        rise()
    else:
        with pytest.raises(NoMotion):
            rise()
    heights = dict.fromkeys(float(goal.T_world_tip.translation_m[2] - HIGH[2]) for goal in runner.goals)
    assert list(heights) == pytest.approx([0.02 * share for share in shares])
    assert events == ["not_lifted"] * lasting


@pytest.mark.slow
def test_a_fragment_over_which_an_arm_is_not_seen_is_soon_for_the_other_one(monkeypatch, tmp_path):
    eyes = Eyes()
    eyes.hidden = (("right", 1.0, np.inf),)
    trial = play(monkeypatch, tmp_path, eyes, fragments=2, budget_s=120.0)
    blocked = [e for e in trial.events if e["name"] == "fragment" and e["outcome"] == "BLOCKED"]
    assert {e["arm"] for e in blocked} == {"right"}
    assert "hidden" in blocked[0]["reason"]
    assert blocked[0]["time_s"] < 12.0
    assert sum(score["succeeded"] for score in trial.scores) == 2


CLING_N, DENSITY_KG_M3 = 1.4e-3, 160.0


class Touching(Eyes):
    def holding(self, image, T_world_camera, model, T_world_tip, jaw_rad):
        return bool(self.lab.truth().touched_by[self.arm_of(model)][-1].any())


def charged(scene):
    light = [replace(f, cling_n=CLING_N, density_kg_m3=DENSITY_KG_M3) for f in scene.fragments]
    return replace(scene, fragments=tuple(light))


def test_a_fragment_that_both_fingers_draw_up_between_them_comes_off(monkeypatch, tmp_path):
    trial = play(monkeypatch, tmp_path, Touching(), seed=4, change=charged, arms=1, fragments=1, budget_s=120.0)
    *_, said = [e for e in trial.events if e["name"] == "fragment"]  # one that falls beside the receptacle comes again
    *_, released = [e for e in trial.events if e["name"] == "releasing"]
    assert said["time_s"] - released["time_s"] > 1.0, "it clung"
    assert said["outcome"] == "DONE"
    # closing jaws may squeeze it out sideways, and then it lies beside the receptacle
    assert trial.scores[0]["failure"] in ("", "DROPOFF_FAILURE")


def test_what_has_not_helped_in_one_way_is_tried_in_another():
    done = []

    class Arm(RavenArm):
        def __init__(self):
            self.places = SimpleNamespace(table_m=-0.162)

        async def jaw(self, angle_rad):
            done.append(("jaw", angle_rad))

        async def rise(self, by_m):
            done.append(("rise", by_m))

        async def stroke(self, height_m, open_rad):
            done.append(("stroke", height_m, open_rad))

    async def shed():
        arm = Arm()
        for number in range(WAYS):
            await arm.shed(number)
            opened = [way for way in done if way[0] == "jaw"]
            assert opened[-1] == ("jaw", SHAKEN_RAD), "a fragment is looked for at jaws that are wide open"

    trio.run(shed)
    strokes = [way for way in done if way[0] == "stroke"]
    assert len(strokes) == len(set(strokes)) == len(STROKES)
    assert all(0.010 < height_m + 0.162 < 0.015 for _, height_m, _ in strokes), "over the receptacle's floor"


def test_an_arm_that_begins_to_lift_too_near_a_wall_first_rises_over_it():
    class Near(NoMotion):
        begins_too_near = True

    low, table = np.array([-0.05, -0.05, -0.150]), float(TABLE.translation_m[2])
    for refusal, height_m in ((Near, table + best().drop_high_m), (NoMotion, low[2] + best().lift_m)):
        arm, runner = raven_arm(low, [refusal("left", NoPlan("no way"), lasting=True), low + [0, 0, height_m - low[2]]])
        trio.run(arm._lift, TipGoal(SE3.from_parts(translation_m=HIGH), 0.05), best().lift_m)
        assert runner.goals[1].straight and runner.goals[1].T_world_tip.translation_m[2] == pytest.approx(height_m)


LIFT_M = best().lift_m
HIDDEN_S = 1.6


def times(trial, name):
    return [e["time_s"] for e in trial.events if e["name"] == name]


def tips_m(trial, arm):
    scenery = trial.scenery
    q = trial.arrays[f"true_{arm}"][:, :6].astype(float)
    return (scenery.T_world_base[arm] @ fk(scenery.arms[arm], q)).translation_m


def test_an_arm_lifts_straight_up_and_goes_on_without_a_stop(monkeypatch, tmp_path):
    trial = play(monkeypatch, tmp_path, Eyes(), arms=1, fragments=1, budget_s=60.0)
    first, last = (round(100 * times(trial, name)[0]) for name in ("closing", "releasing"))
    tip = tips_m(trial, "left")[first:last]
    assert np.linalg.norm(tip[-1, :2] - tip[0, :2]) > 0.03, "the receptacle is elsewhere"
    lifted = int(np.flatnonzero(tip[:, 2] > tip[0, 2] + LIFT_M)[0])
    assert np.linalg.norm(tip[lifted, :2] - tip[0, :2]) < 0.5 * LIFT_M
    leaves = int(np.flatnonzero(tip[:, 2] > tip[0, 2] + 0.2 * LIFT_M)[0])
    arrives = int(np.flatnonzero(np.linalg.norm(tip - tip[-1], axis=-1) < 0.02)[0])
    speeds = np.linalg.norm(tip[leaves + 10 : arrives] - tip[leaves : arrives - 10], axis=-1) / 0.1
    assert speeds.min() > 0.005, "m/s"


def test_jaws_that_are_hidden_are_not_taken_to_be_empty(monkeypatch, tmp_path):
    class Crossed(Eyes):
        """Something passes before the jaws, and what they hold, just after they have closed."""

        def crossed(self):
            closed = [e["time_s"] for e in self.lab.log.events if e["name"] == "closing"]
            return bool(closed) and self.lab.now_s() - closed[-1] < HIDDEN_S

        def gripper(self, *args):
            return None if self.crossed() else super().gripper(*args)

        def holding(self, *args):
            return not self.crossed() and super().holding(*args)

    trial = play(monkeypatch, tmp_path, Crossed(), arms=1, fragments=1, budget_s=60.0)
    (said,) = [e for e in trial.events if e["name"] == "pickup"]
    assert said["holding"]
    assert said["image_s"] > times(trial, "closing")[0] + HIDDEN_S - 0.1
    assert trial.scores[0]["first_attempt"]
