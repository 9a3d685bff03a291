"""No arm starts a motion that would bring it too close to the other."""

from dataclasses import replace

import numpy as np
import pytest
import trio

from simulated import ideal_laboratory, joints_at, standing
from trocar.geometry import SE3, SO3
from trocar.motion import rest_to_rest
from trocar.robots.arm_script import ArmScript
from trocar.tasks.peg_transfer.agents.settings import Settings
from trocar.tasks.peg_transfer.agents.traffic import Blocked, Traffic
from trocar.tasks.peg_transfer.shapes import Block
from two_armed import distance_of_arms_m, named

SETTINGS = replace(Settings(), patience_s=1.0)
MIDDLE_M = (0.0, 0.0, 0.05)
AWAY_M = {"psm1": (0.05, 0.0, 0.05), "psm2": (-0.05, 0.0, 0.05)}


class Two:
    """Both arms of an ideal cell, and their traffic."""

    def __init__(self):
        self.lab = ideal_laboratory(standing(0))
        self.traffic = Traffic(self.lab.cell, Block(), SETTINGS)
        self.hands = {name: ArmScript(self.lab.cell, name, SETTINGS.limits, 0.0) for name in AWAY_M}
        for hand in self.hands.values():
            self.traffic.join(hand)

    async def go(self, name, p_world_m, **kwargs):
        hand = self.hands[name]
        motion = rest_to_rest(hand.q, joints_at(name, p_world_m), SETTINGS.limits)
        await self.traffic.admit(hand, motion, **kwargs)
        return await self.traffic.run(hand, motion)

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
    assert distance_of_arms_m(two.lab) > SETTINGS.margin_m - 0.5e-3 and named(two.lab, "guard") == []


def test_a_way_that_is_free_is_taken_at_once():
    two = Two()

    async def script():
        async with trio.open_nursery() as nursery:
            for name, place in AWAY_M.items():
                nursery.start_soon(two.go, name, place)

    two.run(script)
    assert two.waited_s("psm1") == two.waited_s("psm2") == 0.0


def test_waiting_ends_where_the_other_arm_stays():
    two = Two()

    async def script():
        await two.go("psm1", MIDDLE_M)
        with pytest.raises(Blocked):
            await two.go("psm2", MIDDLE_M)

    two.run(script)
    assert two.waited_s("psm2") == pytest.approx(SETTINGS.patience_s, abs=0.05)


def test_of_two_arms_that_wait_for_each_other_one_is_told_at_once():
    two, blocked = Two(), []
    places = {"psm1": (0.02, 0.0, 0.05), "psm2": (-0.02, 0.0, 0.05)}

    async def cross(name, place):
        try:
            await two.go(name, place)
        except Blocked:
            blocked.append((name, two.lab.now_s()))

    async def script():
        for name, place in places.items():
            await two.go(name, place)
        start_s = two.lab.now_s()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cross, "psm1", places["psm2"])
            nursery.start_soon(cross, "psm2", places["psm1"])
        assert blocked[0][1] - start_s < 0.1

    two.run(script)
    assert distance_of_arms_m(two.lab) > SETTINGS.margin_m - 0.5e-3


def test_a_block_in_the_jaws_needs_room_too():
    beside_m = {"psm1": (0.016, 0.0, 0.05), "psm2": (-0.001, 0.0, 0.05)}

    def waits(T_tip_block):
        two = Two()

        async def script():
            two.traffic.carries("psm1", T_tip_block)
            await two.go("psm1", beside_m["psm1"])
            try:
                await two.go("psm2", beside_m["psm2"])
            except Blocked:
                return

        two.run(script)
        return two.waited_s("psm2") > 0

    hanging = SE3.from_parts(SO3.axis("x", np.pi), [-5e-3, 0.0, 4e-3])
    assert not waits(None) and waits(hanging)
