"""What an arm does next, with a scripted arm and camera: stories that take milliseconds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trio
from trio.testing import MockClock

from trocar.errors import ArmStopped, NoPlan
from trocar.geometry import SE3
from trocar.log import CellLog
from trocar.robots.coordinator import Coordinator
from trocar.tasks.debridement.agents.allocation import Allocation
from trocar.tasks.debridement.agents.debrider import CLEAR_M, FRESH_S, LOOK_S, RECEPTACLE, TOO_MANY, Debrider, run_all
from trocar.tasks.debridement.agents.motions import NoMotion
from trocar.tasks.debridement.agents.observer import CameraFrozen, Observation
from trocar.tasks.debridement.agents.raven_arm import WAYS
from trocar.tasks.debridement.agents.settings import best, paper
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.perception.fragments import SeenFragment

TABLE = SE3.from_parts(translation_m=[-0.0745, 0.0, -0.162])
LEFT_M, RIGHT_M = (-0.03, -0.07), (-0.12, -0.06)
NO_MOTION = NoMotion("left", NoPlan("no way"), lasting=True)
STEP_S = 1.0


def lying(place_m, height_m=0.004):
    p = np.array([*place_m, TABLE.translation_m[2] + height_m])
    return SeenFragment(p, np.array([0.012, 0.009]), 0.0, height_m, 500)


class Arm:
    """An arm that does what it is told in a second, unless a test has it fail; it notes what it did.

    Attributes:
        fails: what the next actions of a name raise, in order; None: nothing.
        holding: what the camera says of the jaws after each grasp, in order; then that they hold something.
        clinging: how often a fragment clings to the open jaws.
        takes_s: how long actions take, by name; default: a second.
    """

    def __init__(self, stage, name, settings):
        self.stage, self.name, self.s, self.cell = stage, name, settings, stage.cell
        self.fails, self.holding, self.clinging, self.within_reach = {}, [], 0, True
        self.did, self.carried, self.over, self.takes_s = [], None, False, {}
        self.turn_rad, self.height_m, self.side = 0.0, 0.0, 1 if name == "left" else -1
        self.model = SimpleNamespace(jaw=SimpleNamespace(max_speed=3.0))
        self.robot = SimpleNamespace(
            T_world_tip=lambda name: SE3.from_parts(translation_m=[0.0, 0.0, 0.1]),
            read=lambda name: SimpleNamespace(jaw_rad=1.2),
        )
        self.places = SimpleNamespace(
            hold=lambda *_: "beside", home=lambda *_: "home", drop=lambda *_: "over", grasps=self.grasps,
            table_m=float(TABLE.translation_m[2]),
        )  # fmt: skip
        nothing = SimpleNamespace(take=lambda *_: None, let_go=lambda *_: None, taken=0)
        self.observer = SimpleNamespace(
            memory=nothing, observe=self.observe, holds=self.holds, clings=self.clings, follow=self.follow
        )

    def grasps(self, fragment, others, model, turn_rad, failures):
        return [SimpleNamespace(way=way, fragment=fragment, open_rad=1.0) for way in range(failures, failures + 3)]

    def possible(self, grasps):
        return grasps[0] if self.within_reach else None

    async def act(self, name, *what):
        self.did.append((name, *what))
        await trio.sleep(self.takes_s.get(name, STEP_S))
        failures = self.fails.get(name)
        if failures and (error := failures.pop(0)) is not None:
            raise error

    async def come_into_sight(self):
        await self.act("search")
        return Observation(self.stage.lying)

    async def reach(self, grasp):
        await self.act("reach", grasp.way)
        self.carried = grasp.fragment

    async def close(self):
        self.did.append(("close",))

    async def rise(self, by_m):
        self.height_m += by_m

    async def jaw(self, angle_rad):
        if self.over:
            self.stage.lying = [f for f in self.stage.lying if f is not self.carried]
        await self.act("jaw", angle_rad)

    async def shed(self, number):
        await self.act("shed", number)
        self.clinging -= 1

    async def go_to_one(self, place, lift_m=0.0, enough=None):
        await self.act("go", place)
        self.height_m += lift_m
        self.over = place == "over"
        alone = not self.over or not self.s.token or self.stage.coordinator.try_reserve(self.name, RECEPTACLE)
        assert alone, "nobody else may be there"

    async def observe(self, name):
        await self.act("look")
        return Observation(self.stage.lying)

    async def holds(self, name):
        held = self.holding.pop(0) if self.holding else True
        self.carried = self.carried if held else None
        return held

    async def clings(self, name):
        return self.clinging > 0

    async def follow(self, name):
        await trio.sleep_forever()


class Stage:
    """Two arms, their allocation and coordinator, and fragments that lie where a test puts them."""

    def __init__(self, lying, settings=None, goals=None):
        self.log, self.lying = CellLog(trio.current_time), list(lying)
        names = dict.fromkeys(("left", "right"))
        clock = SimpleNamespace(now_s=trio.current_time, sleep=trio.sleep)
        self.cell = SimpleNamespace(
            log=self.log, clock=clock, arms=names, T_world_base_registered=names, choose=self.choose
        )
        self.coordinator = Coordinator(self.cell, tuple(names))
        workspace = replace(Workspace(), fragments=len(self.lying))
        goals = len(self.lying) if goals is None else goals
        self.allocation = Allocation(self.coordinator, workspace, TABLE, TABLE, goals)
        self.arms = {name: Arm(self, name, settings or best()) for name in names}

    async def choose(self, goals):
        """Take the first, as a cell without a person does."""
        return 0

    async def run(self, *names):
        await run_all([Debrider(self.arms[name], self.allocation) for name in names])

    def outcomes(self, *arms):
        named = [e for e in self.log.events if e["name"] == "fragment"]
        return [e["outcome"] for e in named if not arms or e["arm"] in arms]


def played(script, *args, **kwargs):
    async def main():
        stage = Stage(*args, **kwargs)
        with trio.fail_after(600.0):
            await script(stage)
        return stage

    return trio.run(main, clock=MockClock(autojump_threshold=0))


@pytest.mark.parametrize("settings", [best(), paper()])
def test_an_arm_takes_a_fragment_over_the_receptacle_looks_and_goes_home(settings):
    async def script(stage):
        await stage.run("left")
        did = [action for action in stage.arms["left"].did if action[0] not in ("jaw", "close")]
        if settings.flows:  # the search has shown what lies there, and it looks while its jaws open
            assert did == [("search",), ("reach", 0), ("go", "over"), ("look",), ("go", "home"), ("look",)]
        else:
            beside = ("go", "beside")
            assert did == [
                ("search",), ("look",), ("reach", 0), beside, ("go", "over"), ("go", "home"), ("look",)
            ]  # fmt: skip
        assert stage.outcomes() == ["DONE"]
        assert stage.coordinator.try_reserve("right", RECEPTACLE), "it has left the receptacle"

    played(script, [lying(LEFT_M)], settings=settings)


@pytest.mark.parametrize("token", [False, True])
def test_each_arm_clears_its_side_and_with_a_token_one_waits_beside_the_receptacle(token):
    async def script(stage):
        for arm in stage.arms.values():
            arm.takes_s = {"jaw": 3.0}
        await stage.run("left", "right")
        assert stage.outcomes() == ["DONE", "DONE"] and not stage.lying
        releases = [event["time_s"] for event in stage.log.events if event["name"] == "releasing"]
        beside = [name for name, arm in stage.arms.items() if ("go", "beside") in arm.did]
        assert beside == (["left", "right"] if token else [])
        assert (releases[1] - releases[0] > 2.9) == token, "one after the other"
        assert {arm.carried.p_world_m[0] for arm in stage.arms.values()} == {LEFT_M[0], RIGHT_M[0]}

    played(script, [lying(LEFT_M), lying(RIGHT_M)], settings=replace(best(), token=token))


def test_an_arm_for_which_nothing_is_left_waits_for_the_other_one_and_looks_again():
    async def script(stage):
        await stage.run("left", "right")
        first = next(name for name, arm in stage.arms.items() if ("reach", 0) in arm.did)
        other = "left" if first == "right" else "right"
        assert stage.outcomes() == ["DONE"] and stage.outcomes(other) == []
        assert not any(action[0] == "reach" for action in stage.arms[other].did)
        assert any((s.arm, s.name) == (other, "waiting") for s in stage.log.spans)

    played(script, [lying(LEFT_M)])


def test_an_arm_whose_fragment_was_freed_while_it_went_home_looks_again_at_once():
    """Both fragments lie together; once the other arm has carried one of them off, this arm may take the other."""
    near = (LEFT_M[0] - 0.02, LEFT_M[1])

    async def script(stage):
        stage.arms["right"].takes_s = {"search": 1.1, "go": 2.2, "look": 0.5}
        await stage.run("left", "right")
        assert stage.outcomes() == ["DONE", "DONE"]
        taken = {name: [a for a in arm.did if a[0] == "reach"] for name, arm in stage.arms.items()}
        assert all(len(takes) == 1 for takes in taken.values()), "neither waited for the other one to come back"

    played(script, [lying(LEFT_M), lying(near)])


def test_a_look_at_a_release_does_not_count_if_the_other_arm_has_taken_one_since():
    async def script(stage):
        arm = stage.arms["left"]

        def take(*_):
            arm.observer.memory.taken += 1

        arm.observer.memory.take = take
        debrider = Debrider(arm, stage.allocation)
        await debrider._look_ahead()
        assert await debrider._observed() == Observation(stage.lying) and arm.did == [("look",)]
        await debrider._look_ahead()
        take()
        await debrider._observed()
        assert arm.did == [("look",)] * 3
        await debrider._look_ahead()
        await trio.sleep(2 * FRESH_S)
        await debrider._observed()
        assert arm.did == [("look",)] * 5

    played(script, [lying(LEFT_M)])


def test_an_arm_takes_the_outermost_fragment_even_if_it_hides_it():
    """The other arm's would be in its way there."""
    hidden, seen = lying(LEFT_M), lying(RIGHT_M)

    async def script(stage):
        debrider = Debrider(stage.arms["left"], stage.allocation)
        debrider._keep(Observation([seen], [hidden]))
        fragment, _ = await debrider._allocated()
        assert fragment is hidden

    played(script, [hidden, seen])


@pytest.mark.parametrize("settings", [best(), paper()])
def test_what_jaws_close_on_lies_there_until_they_have_had_the_time_to_close(settings):
    """The other arm may look meanwhile."""

    async def script(stage):
        arm, times_s = stage.arms["left"], {}
        arm.observer.memory.take = lambda *_: times_s.update(taken=trio.current_time())
        closing_s = 1.0 / arm.model.jaw.max_speed  # `Arm.grasps` opens by 1 rad

        async def close():
            times_s["closes"] = trio.current_time()
            await trio.sleep(closing_s)

        arm.close = close
        await stage.run("left")
        earlier_s = settings.plan_budget_s if settings.flows else 0.0
        assert times_s["taken"] - times_s["closes"] == pytest.approx(closing_s - earlier_s)

    played(script, [lying(LEFT_M)], settings=settings)


def test_jaws_are_looked_at_once_they_are_too_high_to_show_what_stayed_below_them():
    async def script(stage):
        arm, table_m, looked_at_m = stage.arms["left"], TABLE.translation_m[2], []
        arm.height_m = table_m + 0.012

        async def rise(place, lift_m=0.0, enough=None):
            while place == "over" and arm.height_m < table_m + 0.040:
                arm.height_m += 0.001
                await trio.sleep(0.1)
            await Arm.go_to_one(arm, place)

        async def holds(name):
            looked_at_m.append(arm.height_m - table_m)
            return True

        arm.go_to_one, arm.observer.holds = rise, holds
        await stage.run("left")
        assert stage.outcomes() == ["DONE"] and looked_at_m == [pytest.approx(CLEAR_M, abs=1.1e-3)]

    played(script, [lying(LEFT_M)])


@pytest.mark.parametrize(("height_m", "is_over"), [(CLEAR_M - 1e-3, False), (CLEAR_M + 1e-3, True)])
def test_jaws_do_not_open_where_a_look_at_them_would_show_what_lies_below(height_m, is_over):
    async def script(stage):
        arm, middle = stage.arms["left"], TABLE.translation_m + [0.0, 0.0, height_m]
        arm.robot.T_world_tip = lambda _: SE3.from_parts(translation_m=middle)
        assert Debrider(arm, stage.allocation)._is_over() is is_over

    played(script, [lying(LEFT_M)])


def test_jaws_that_hold_nothing_open_and_the_next_grasp_is_another():
    async def script(stage):
        arm = stage.arms["left"]
        arm.holding = [False]
        await stage.run("left")
        assert stage.outcomes() == ["GRASP_FAILURE", "DONE"]
        assert [way for name, *way in arm.did if name == "reach"] == [[0], [1]]

    played(script, [lying(LEFT_M)])


def test_an_arm_without_a_path_opens_its_jaws_moves_aside_and_leaves_the_fragment_to_the_other_one():
    async def script(stage):
        stage.arms["left"].fails = {"reach": [NO_MOTION] * 9}
        await stage.run("left", "right")
        assert set(stage.outcomes("left")) == {"BLOCKED"} and "DONE" in stage.outcomes("right")
        did = stage.arms["left"].did
        at = did.index(("reach", 0))
        assert did[at + 1 : at + 3] == [("jaw", best().open_rad), ("go", "beside")]

    played(script, [lying(LEFT_M), lying(RIGHT_M)])


@pytest.mark.parametrize("goals", [1, 2])
@pytest.mark.parametrize("refused", [1, 9])
def test_an_arm_that_finds_no_way_home_tries_again_once_whether_or_not_all_is_cleared(refused, goals):
    async def script(stage):
        arm = stage.arms["left"]
        arm.fails = {"go": [None] + [NO_MOTION] * refused}
        await stage.run("left")
        assert [where for name, *where in arm.did if name == "go"] == [["over"], ["home"], ["home"]]
        assert [e["arm"] for e in stage.log.events if e["name"] == "stayed"] == ["left"] * min(refused, 2)

    played(script, [lying(LEFT_M)], goals=goals)


def test_an_arm_that_fails_too_often_in_a_row_gives_up():
    async def script(stage):
        stage.arms["left"].holding = [False] * 20
        await stage.run("left")
        assert stage.outcomes() == ["GRASP_FAILURE"] * TOO_MANY
        assert stage.arms["left"].did[-1] == ("go", "home")

    played(script, [lying(LEFT_M)])


@pytest.mark.parametrize(("clinging", "outcome"), [(0, "DONE"), (2, "DONE"), (WAYS, "DONE"), (99, "STUCK_IN_JAWS")])
def test_what_clings_is_shaken_off_in_all_ways_there_are(clinging, outcome):
    async def script(stage):
        arm = stage.arms["left"]
        arm.clinging = clinging
        await stage.run("left")
        assert stage.outcomes() == [outcome]
        assert [number for name, *number in arm.did if name == "shed"] == [[n] for n in range(min(clinging, WAYS))]

    played(script, [lying(LEFT_M)])


def test_an_arm_sets_out_for_the_next_fragment_before_it_is_known_that_the_last_one_fell():
    async def script(stage):
        arm, began_s = stage.arms["left"], []

        async def reach(grasp):
            began_s.append(trio.current_time())
            await Arm.reach(arm, grasp)

        arm.reach, arm.takes_s = reach, {"jaw": 1.5, "look": 0.1}
        await stage.run("left")
        done = [event for event in stage.log.events if event["name"] == "fragment"]
        assert [event["outcome"] for event in done] == ["DONE", "DONE"] and not stage.lying
        released_s = next(event["time_s"] for event in stage.log.events if event["name"] == "releasing")
        assert began_s[1] == pytest.approx(released_s + LOOK_S + 0.1)
        assert done[0]["time_s"] == pytest.approx(released_s + 1.5) and done[0]["start_s"] == pytest.approx(began_s[0])
        assert done[1]["start_s"] == pytest.approx(began_s[1])

    played(script, [lying(LEFT_M), lying(RIGHT_M)])


def test_a_fragment_seen_to_cling_on_the_way_to_the_next_one_is_shaken_off_first():
    async def script(stage):
        arm = stage.arms["left"]
        arm.clinging, arm.takes_s = 2, {"look": 0.1, "reach": 3.0}
        await stage.run("left")
        assert stage.outcomes() == ["DONE", "DONE"] and stage.allocation.cleared == 2
        acts = [(name, *what) for name, *what in arm.did if name in ("reach", "shed", "jaw")]
        parted = ("jaw", best().open_rad)
        assert acts == [("reach", 0), parted, ("reach", 0), ("shed", 0), ("shed", 1), ("reach", 0), parted]
        done = [event for event in stage.log.events if event["name"] == "fragment"]
        assert done[1]["start_s"] == done[0]["time_s"] and ("look",) in arm.did[arm.did.index(("shed", 1)) :]

    played(script, [lying(LEFT_M), lying(RIGHT_M)])


def test_jaws_that_stop_while_they_part_stop_the_arm_on_its_way_to_the_next_fragment():
    async def script(stage):
        arm = stage.arms["left"]
        arm.fails, arm.takes_s = {"jaw": [ArmStopped("left", "left does not answer")]}, {"look": 0.1}
        await stage.run("left")
        assert stage.outcomes() == ["ARM_STOPPED"] and arm.did[-1] == ("reach", 0)

    played(script, [lying(LEFT_M), lying(RIGHT_M)])


def test_an_arm_that_stops_keeps_its_place_and_the_other_one_goes_on():
    async def script(stage):
        stage.arms["left"].fails = {"go": [ArmStopped("left", "left does not answer")]}
        await stage.run("left", "right")
        assert stage.outcomes("left") == ["ARM_STOPPED"] and stage.outcomes("right").count("DONE") == 1
        assert stage.allocation.claimed["left"][2] == 0.1 and stage.allocation.busy == set()

    played(script, [lying(LEFT_M), lying(RIGHT_M)], goals=1)


def test_a_fragment_out_of_reach_is_named_once_nobody_else_may_take_it():
    async def script(stage):
        stage.arms["left"].within_reach = False
        await stage.run("left")
        assert set(stage.outcomes()) == {"OUT_OF_REACH"} and not any(a[0] == "reach" for a in stage.arms["left"].did)
        assert "(-30, -70) mm" in stage.log.events[0]["reason"]

    played(script, [lying(LEFT_M)])


def test_a_full_receptacle_is_for_a_person():
    heap = [lying((x, 0.0), Workspace().receptacle.height_m) for x in (-0.1, -0.075, -0.05)]

    async def script(stage):
        stage.arms["left"].holding = [False] * 20
        await stage.run("left")
        assert stage.outcomes()[-1] == "RECEPTACLE_FULL" and stage.arms["left"].did[-1] == ("go", "home")

    played(script, [lying(LEFT_M), *heap], goals=1)


def test_an_arm_that_stops_on_its_way_home_after_giving_up_keeps_its_place():
    async def script(stage):
        arm = stage.arms["left"]
        arm.clinging, arm.fails = 99, {"go": [None, ArmStopped("left", "left does not answer")]}
        await stage.run("left")
        assert stage.outcomes() == ["STUCK_IN_JAWS", "ARM_STOPPED"] and "left" in stage.allocation.claimed

    played(script, [lying(LEFT_M)])


@pytest.mark.parametrize("during", ["search", "reach", "look"])
def test_a_frozen_camera_ends_both_scripts_where_the_arms_are(during):
    async def script(stage):
        stage.arms["right"].fails = {during: [CameraFrozen("no new image")]}
        await stage.run("left", "right")
        assert stage.outcomes("right") == ["CAMERA_FROZEN"] and stage.outcomes("left")[-1] == "CAMERA_FROZEN"
        assert ("go", "home") not in stage.arms["right"].did
        if during != "look":  # by then, the left arm has cleared its fragment and gone home
            assert stage.outcomes("left") == ["CAMERA_FROZEN"] and ("go", "home") not in stage.arms["left"].did

    played(script, [lying(LEFT_M), lying(RIGHT_M)])


def allocated(stage):
    """Return the places (2,) of the fragments that arms took, in order, and which arm it was."""
    taken = [event for event in stage.log.events if event["name"] == "allocated"]
    return [tuple(np.round(event["place"][:2], 3).tolist()) for event in taken], [event["arm"] for event in taken]


def test_an_arm_takes_the_fragment_that_a_person_chooses():
    told = []

    async def script(stage):
        async def choose(goals):
            told.append(goals)
            return len(goals) - 1

        stage.cell.choose = choose
        await stage.run("left")

    stage = played(script, [lying(LEFT_M), lying(RIGHT_M)])
    assert allocated(stage)[0] == [RIGHT_M, LEFT_M]  # the script's own first choice is the outermost on its side
    assert [len(goals) for goals in told] == [2, 1]
    assert [goal.words for goal in told[0]] == [
        "takes the fragment at (-30, -70) mm",
        "takes the fragment at (-120, -60) mm",
    ]
    assert {goal.arm for goals in told for goal in goals} == {"left"}
    for goal, place in zip(told[0], (LEFT_M, RIGHT_M), strict=True):
        np.testing.assert_allclose(goal.path_world_m[0, :2], place)
        np.testing.assert_allclose(goal.path_world_m[-1], TABLE.translation_m)


def test_a_fragment_that_the_other_arm_has_claimed_while_a_person_chose_is_not_taken():
    async def script(stage):
        async def choose(goals):  # slow, and always the same fragment
            places = [goal.path_world_m[0, :2] for goal in goals]
            await trio.sleep(0.3)
            return int(np.argmin([np.linalg.norm(place - RIGHT_M) for place in places]))

        stage.cell.choose = choose
        await stage.run("left", "right")

    stage = played(script, [lying(LEFT_M), lying(RIGHT_M)])
    assert sorted(allocated(stage)[0]) == sorted([LEFT_M, RIGHT_M])
    assert stage.outcomes() == ["DONE", "DONE"]
