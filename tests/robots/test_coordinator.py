"""Several arms in one space: none starts a motion that would bring it too close to another; they share and wait."""

from math import inf
from types import SimpleNamespace

import numpy as np
import pytest
import trio
from trio.testing import MockClock

from simulated import ideal_laboratory, joints_at, standing
from trocar.arms import MOTION_LIMITS
from trocar.geometry.capsules import Capsules
from trocar.log import CellLog
from trocar.motion import rest_to_rest
from trocar.robots.arm_script import ArmScript
from trocar.robots.coordinator import Blocked, Coordinator, Margins
from trocar.robots.traffic import Departure
from two_armed import distance_of_arms_m, named

MARGINS = Margins(patience_s=1.0)
LIMITS = MOTION_LIMITS["paper"]
MIDDLE_M = (0.0, 0.0, 0.05)
AWAY_M = {"psm1": (0.05, 0.0, 0.05), "psm2": (-0.05, 0.0, 0.05)}


class Two:
    """Both arms of an ideal cell, and their coordinator."""

    def __init__(self):
        self.lab = ideal_laboratory(standing(0))
        self.coordinator = Coordinator(self.lab.cell, tuple(AWAY_M), MARGINS)
        self.hands = {name: ArmScript(self.lab.cell, name, 0.0) for name in AWAY_M}

    def motion(self, name, p_world_m):
        return rest_to_rest(self.hands[name].q, joints_at(name, p_world_m), LIMITS)

    async def go(self, name, p_world_m, **kwargs):
        motion = self.motion(name, p_world_m)
        await self.coordinator.admit(name, motion, jaw_rad=self.hands[name].jaw_rad, **kwargs)
        return await self.coordinator.run(name, motion)

    def run(self, script):
        assert self.lab.run(lambda cell: script(), 30.0)

    def waited_s(self, name):
        return sum(s.end_s - s.start_s for s in self.lab.log.spans if (s.arm, s.name) == (name, "waiting"))


def test_an_arm_waits_until_the_place_is_free():
    two = Two()

    async def come_and_go():
        await two.go("psm1", MIDDLE_M)
        await two.go("psm1", AWAY_M["psm1"])

    async def script():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(come_and_go)
            await trio.sleep(0.05)
            await two.go("psm2", MIDDLE_M)

    two.run(script)
    assert two.waited_s("psm2") > 0.2 and two.waited_s("psm1") == 0.0
    assert distance_of_arms_m(two.lab) > MARGINS.margin_m - 0.5e-3 and named(two.lab, "guard") == []


def test_a_motion_that_is_free_starts_at_once():
    two = Two()

    async def script():
        async with trio.open_nursery() as nursery:
            for name, place in AWAY_M.items():
                nursery.start_soon(two.go, name, place)

    two.run(script)
    assert two.waited_s("psm1") == two.waited_s("psm2") == 0.0


@pytest.mark.parametrize(("waits", "waited_s"), [(True, MARGINS.patience_s), (False, 0.0)])
def test_waiting_ends_where_the_other_arm_stays(waits, waited_s):
    two = Two()

    async def script():
        await two.go("psm1", MIDDLE_M)
        with pytest.raises(Blocked) as blocked:
            await two.go("psm2", MIDDLE_M, waits=waits)
        assert blocked.value.arm == "psm2"

    two.run(script)
    assert two.waited_s("psm2") == pytest.approx(waited_s, abs=0.05)


@pytest.mark.parametrize("carrier", ["", "psm1", "psm2"])
def test_of_two_arms_that_wait_for_each_other_the_empty_one_gives_way_at_once(carrier):
    two, blocked = Two(), []
    places = {"psm1": (0.02, 0.0, 0.05), "psm2": (-0.02, 0.0, 0.05)}
    thread = Capsules(np.zeros((1, 2, 3)), np.array([1e-5]))

    async def cross(name, place):
        try:
            await two.go(name, place)
        except Blocked:
            blocked.append((name, two.lab.now_s()))

    async def script():
        for name, place in places.items():
            await two.go(name, place)
        if carrier:
            two.coordinator.carry(carrier, thread)
        start_s = two.lab.now_s()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cross, "psm1", places["psm2"])
            nursery.start_soon(cross, "psm2", places["psm1"])
        assert blocked[0][1] - start_s < 0.1
        if carrier:
            assert blocked[0][0] != carrier and two.coordinator.carries(carrier)

    two.run(script)
    assert distance_of_arms_m(two.lab) > MARGINS.margin_m - 0.5e-3


BESIDE_M = {"psm1": (0.016, 0.0, 0.05), "psm2": (-0.001, 0.0, 0.05)}
HANGING = Capsules(np.array([[[-0.012, 0.0, 0.004], [0.012, 0.0, 0.004]]]), np.array([0.002]))


@pytest.mark.parametrize(
    ("held", "contact_s", "waits"), [(None, None, False), (HANGING, None, True), (HANGING, 0.0, False)]
)
def test_what_is_in_the_jaws_needs_room_too_unless_it_may_be_touched(held, contact_s, waits):
    two = Two()

    async def script():
        two.coordinator.carry("psm1", held)
        await two.go("psm1", BESIDE_M["psm1"])
        try:
            await two.go("psm2", BESIDE_M["psm2"], **({} if contact_s is None else {"contact_s": (contact_s, inf)}))
        except Blocked:
            return

    two.run(script)
    assert (two.waited_s("psm2") > 0) == waits


@pytest.mark.parametrize("blocked", [False, True])
def test_an_arm_goes_only_where_it_can_get_away_from(blocked):
    two = Two()

    async def script():
        await two.go("psm1", (0.02, 0.0, 0.05))
        there_m = (-0.02, 0.0, 0.05)
        away = two.motion("psm2", there_m)
        start, goal = joints_at("psm2", there_m), joints_at("psm2", (0.02, 0.0, 0.05) if blocked else AWAY_M["psm2"])
        departure = Departure(rest_to_rest(start, goal, LIMITS))
        await two.coordinator.admit("psm2", away, departure=departure, waits=False)
        await two.coordinator.run("psm2", away)

    if blocked:
        with pytest.raises(Blocked):
            two.run(script)
    else:
        two.run(script)


ARMS = {"a": None, "b": None}


def scripted(script):
    """Run scripts of two arms that only wait for each other; return the log and the time that passed."""
    log = CellLog(trio.current_time)
    cell = SimpleNamespace(log=log, arms=ARMS, T_world_base_registered=ARMS)

    async def run():
        begin_s = trio.current_time()
        await script(Coordinator(cell, ("a", "b")))
        return trio.current_time() - begin_s

    return log, trio.run(run, clock=MockClock(autojump_threshold=0))


def waits(log):
    return [(span.arm, span.name) for span in log.spans]


@pytest.mark.parametrize(("steps", "waited_s"), [((0.5, 1.0), 0.7), ((inf,), 0.3), ((0.5, 0.9), 2.0)])
def test_an_arm_waits_until_the_other_has_come_as_far_or_has_finished_but_not_forever(steps, waited_s):
    async def script(coordinator):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(come_later, coordinator)
            await coordinator.wait_for_others("a", 1.0, patience_s=2.0)

    async def come_later(coordinator):
        for step, after_s in zip(steps, (0.3, 0.4), strict=False):
            await trio.sleep(after_s)
            coordinator.reached("b", step)

    log, seconds = scripted(script)
    assert waits(log) == [("a", "waiting")] and seconds == pytest.approx(waited_s)


def test_an_arm_that_is_behind_does_not_wait():
    async def script(coordinator):
        coordinator.reached("b", 3.0)
        await coordinator.wait_for_others("a", 2.5, patience_s=2.0)

    assert scripted(script)[1] == 0.0


def test_a_space_is_for_one_arm_at_a_time_in_the_order_of_asking():
    order = []

    async def hold(coordinator, arm, seconds):
        await coordinator.reserve(arm, "tray")
        assert coordinator.try_reserve(arm, "tray"), "it has it, whichever of its tasks asks"
        order.append(arm)
        await trio.sleep(seconds)
        coordinator.release(arm, "tray")

    async def script(coordinator):
        assert coordinator.try_reserve("a", "tray") and not coordinator.try_reserve("b", "tray")
        assert coordinator.try_reserve("b", "another")
        coordinator.release("b", "tray")
        assert not coordinator.try_reserve("b", "tray"), "nobody gives away what is another's"
        async with trio.open_nursery() as nursery:
            with trio.move_on_after(0.1):
                await coordinator.reserve("b", "tray")
            nursery.start_soon(hold, coordinator, "b", 1.0)
            await trio.sleep(0.1)
            nursery.start_soon(hold, coordinator, "c", 1.0)
            await trio.sleep(0.1)
            coordinator.release("a", "tray")
            assert not coordinator.try_reserve("a", "tray"), "the next one gets it, before it is awake"
        assert order == ["b", "c"]
        assert coordinator.try_reserve("a", "tray")

    assert scripted(script)[1] == pytest.approx(2.3)


def test_arms_decide_together_once_each_one_at_work_has_asked():
    decided = []

    async def decide(asked):
        decided.append(dict(asked))
        await trio.sleep(0.5)
        return {arm: 10 * value for arm, value in asked.items()}

    async def script(coordinator):
        answers = {}

        async def ask(arm, value):
            answers[arm] = await coordinator.decide_together(arm, value, decide)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask, "a", 1)
            await trio.sleep(1.0)
            assert not decided, "b may ask too"
            nursery.start_soon(ask, "b", 2)
        assert decided == [{"a": 1, "b": 2}] and answers == {"a": 10, "b": 20}
        with coordinator.idle("b"):
            await ask("a", 3)
        assert decided[1] == {"a": 3}
        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask, "b", 4)
            await trio.sleep(1.0)
            assert len(decided) == 2, "a is at work"
            coordinator.leave("a")
        assert decided[2] == {"b": 4}

    log, seconds = scripted(script)
    assert seconds == pytest.approx(3.5)
    assert ("b", "planning") in waits(log), "the first arm decides for both"
