"""The arm that takes a block from the other and places it: wait above, look, come down round a wall, close."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np
import trio

from trocar.geometry import SE3, SO3
from trocar.motion import TimedPath
from trocar.robots.concurrency import Pending
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents.meeting import ASIDE_M, HandoverState, Side
from trocar.tasks.peg_transfer.agents.motions import Carriage, Joints, end_of, raised, starts_at
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.unilateral import OneArm, withdraw
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp, held_block, yaw_of

BEGINS_S = 0.15
"""An arm that brings a block begins to move within this time once there is room: it looks again after .08 s at most
(``DELAY_STEP_S`` of the traffic), which takes .02 s."""
UPRIGHT = 0.999
"""A tool is vertical if the cosine of the angle between its z and the board's is above this."""


@dataclass(frozen=True, eq=False)
class Coming:
    """A motion to a grasp of the block in the other arm's jaws, or to a pose above it."""

    path: TimedPath  # over the pegs; to the grasp itself its last piece is straight down
    grasp: Grasp  # with which the block is to be taken
    down_s: float = inf  # time on the path at which the arm begins to descend to it


class Receiver(Side):
    """Waits above, looks, takes the block, looks again, places it."""

    def __init__(self, arm: PegArm, other: PegArm, script: OneArm):
        super().__init__(arm, other, script)
        self._coming: Pending[Coming] = Pending()
        self._looked: Pending[tuple[SE3, Coming | None]] = Pending()
        self._expected: HandoverState | None = None  # whose block is looked at as soon as it is offered

    async def come_near(self, meeting: HandoverState, helpers: trio.Nursery) -> None:
        """Wait to the side until it is known where the block will be offered, then above where it will be grasped."""
        try:
            if not meeting.announced.is_set():
                await self._wait_beside()
                await self.wait_for(meeting.announced, meeting.crowded)
            if meeting.announced.is_set() and meeting.outcome is None:
                await self._wait_above(meeting, helpers)
        except Blocked:
            with suppress(Blocked):  # it may be able to take the block from where it is
                await self.arm.retreat()
        while True:
            await self.wait_for(meeting.crowded, meeting.offered)
            if meeting.offered.is_set():
                return
            if meeting.begun.is_set():  # the other arm has found room meanwhile
                meeting.crowded = trio.Event()
                continue
            try:
                await self._make_room(meeting)
                if meeting.outcome is None:
                    await self._wait_above(meeting, helpers)
            except Blocked:
                await self.arm.give_way()

    async def _make_room(self, meeting: HandoverState) -> None:
        """Leave the way of the arm that brings the block: beside it, or go home if that arm cannot begin even then."""
        meeting.crowded = trio.Event()
        await self._wait_beside()
        with trio.move_on_after(BEGINS_S):
            await self.wait_for(meeting.begun)
        if not meeting.begun.is_set():
            await self.arm.go_home()
            await self.wait_for(meeting.begun)

    async def _wait_beside(self) -> None:
        """Go to a place beside the handover, on this arm's side and higher; the other arm may be waiting for that."""
        x, y, z = self.settings.meeting_m
        tip_m = z + self.table.block.height_m - self.settings.depth_m
        beside = [x + self.own_side * ASIDE_M, y, tip_m + self.settings.waits_above_m]
        tip = self.arm.T_board_tip
        yaw_rad = yaw_of(tip) if tip.matrix[2, 2] > UPRIGHT else np.pi
        await self.arm.go_over(SE3.from_parts(SO3.axis("z", yaw_rad), beside), waits=False)

    async def _wait_above(self, meeting: HandoverState, helpers: trio.Nursery) -> None:
        """Go above the grasp expected from the giving arm's announcement; look as soon as the block is offered."""
        avoid: list[int] = []
        ready = await self._coming.take()
        for _ in range(1 + self.settings.detours):
            if ready is None or not starts_at(ready.path, self.arm.hand.q):
                ready = await self.arm.plan(lambda: self._find_above(meeting, self.arm.hand.q, avoid))
            if ready is None:
                return
            try:
                await self.arm.move(
                    ready.path.trajectory,
                    begun=partial(self._begin_to_look, meeting, helpers),
                    jaw_rad=self.settings.taking_rad,
                    margin_m=self.settings.meeting_margin_m,
                    waits=False,
                )
                return
            except Blocked:
                avoid.append(ready.grasp.candidate)
                ready = None
        self.cell.log.event("waits beside", arm=self.arm.name)

    def plan_ahead(self, path: TimedPath, meeting: HandoverState, helpers: trio.Nursery) -> None:
        """During a motion, plan how to get from its end above the next block, if that is announced by then."""

        async def plan() -> Coming | None:
            with trio.move_on_after(path.trajectory.duration_s):
                await meeting.announced.wait()
            if meeting.T_board_block is None:
                return None
            return await self.arm.plan(lambda: self._find_above(meeting, end_of(path), []))

        self._coming.start(helpers, plan)

    def _begin_to_look(self, meeting: HandoverState, helpers: trio.Nursery) -> None:
        """Look at the block as soon as it is offered, if the settings say so, and only once for each offer."""
        if self.settings.looks_ahead and self._expected is not meeting:
            self._expected = meeting
            self._looked.start(helpers, partial(self._look_ahead, meeting))

    async def _look_ahead(self, meeting: HandoverState) -> tuple[SE3, Coming | None] | None:
        """Look at the block as soon as it is offered; plan the descent from where this arm's motion ends."""
        await meeting.offered.wait()
        if meeting.outcome is not None or meeting.T_board_block is None:
            return None
        block = await self.arm.eyes.see_held(self.other, meeting.T_board_block)
        if block is None:
            return None
        return block, await self.arm.plan(lambda: self._find_descent(meeting, self.arm.bound_for, block, []))

    def _find_above(self, meeting: HandoverState, q: Joints, avoid: list[int]) -> Coming | None:
        assert meeting.T_board_block is not None and meeting.T_board_giver is not None
        grasp = self._grasp(meeting, meeting.T_board_block, meeting.T_board_giver, avoid)
        return None if grasp is None else Coming(self.arm.motions.over(q, self._above(grasp)), grasp)

    def _find_descent(self, meeting: HandoverState, q: Joints, T_board_block: SE3, avoid: list[int]) -> Coming | None:
        """Return how to get to the block: straight down if the arm is above a grasp, else from above another one."""
        motions, other = self.arm.motions, self.other.T_board_tip
        grasp = self._grasp(meeting, T_board_block, other, avoid, near=motions.tip(q))
        if grasp is not None:
            return Coming(motions.through([q, motions.ik(grasp.T_board_tip)], fixed_wrist=False), grasp, 0.0)
        grasp = self._grasp(meeting, T_board_block, other, avoid)
        if grasp is None:
            return None
        down = [motions.ik(self._above(grasp)), motions.ik(grasp.T_board_tip)]
        path = motions.through([*motions.risen(q), *down], fixed_wrist=False)
        return Coming(path, grasp, float(path.waypoint_times_s[-2]))

    def _above(self, grasp: Grasp) -> SE3:
        tip = grasp.T_board_tip
        return raised(tip, float(tip.translation_m[2]) + self.settings.waits_above_m)

    def _grasp(
        self,
        meeting: HandoverState,
        T_board_block: SE3,
        T_board_giver: SE3,
        avoid: list[int],
        near: SE3 | None = None,
    ) -> Grasp | None:
        """Return how to grasp a block in the other arm's jaws; near a pose of the tip, if one is given."""
        grasp = self.geometry(self.other, self.arm, meeting).choose_taking(T_board_block, T_board_giver, avoid, near)
        if not isinstance(grasp, str):
            return grasp
        if near is None:
            self.cell.log.event("no grasp", arm=self.arm.name, reason=grasp)
        return None

    async def take(self, meeting: HandoverState) -> SE3 | None:
        """Take hold of the block in the other arm's jaws; return its pose in this arm's jaws, or None."""
        assert meeting.T_board_block is not None
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            looked = await self._looked.take()
            block, descent = looked or (await self.arm.eyes.see_held(self.other, meeting.T_board_block), None)
            if block is None:
                await self.arm.go_home()
                block = await self.arm.eyes.see_held(self.other, meeting.T_board_block)
            if block is None:
                return None
            grasp = await self._come(meeting, block, failed, descent)
            if grasp is None:
                meeting.T_board_seen = None if failed else block
                return None
            T_tip_block = held_block(grasp.T_board_tip, block, self.table.block)
            if await self.arm.grip(T_tip_block):
                return T_tip_block
            jaw_rad = round(self.arm.hand.jaw_rad, 4)
            self.cell.log.event("pick failed", arm=self.arm.name, attempt=attempt, jaw_rad=jaw_rad)
            failed.append(grasp.candidate)
            await self.arm.open(self.settings.release_rad)
            await self.rise()
        return None

    async def _come(
        self, meeting: HandoverState, T_board_block: SE3, failed: list[int], ready: Coming | None
    ) -> Grasp | None:
        """Descend with open jaws round a wall of the block that the other arm holds; return the grasp.

        If the other arm is in the way of each try, the last one is made from home.
        """
        avoid = list(failed)
        for attempt in range(1 + self.settings.detours):
            if ready is None or not starts_at(ready.path, self.arm.hand.q):
                ready = await self.arm.plan(partial(self._find_descent, meeting, self.arm.hand.q, T_board_block, avoid))
            if ready is None:
                return None
            try:
                await self.arm.move(
                    ready.path.trajectory,
                    jaw_rad=self.settings.taking_rad,
                    margin_m=self.settings.meeting_margin_m,
                    contact_s=(ready.down_s, inf),
                    waits=attempt == self.settings.detours,
                )
                break
            except Blocked:
                avoid.append(ready.grasp.candidate)
                ready = None
                if attempt == self.settings.detours - 1:
                    await self.arm.go_home()
                    avoid = list(failed)
        else:
            raise Blocked(self.arm.name)
        await self.arm.hand.settle()
        self.cell.log.event("taking", arm=self.arm.name, room_mm=round(1e3 * ready.grasp.clearance_m, 2))
        return ready.grasp

    async def leave(self) -> None:
        """Rise from a block that was not taken, and go home."""
        await self.rise()
        await withdraw(self.arm)

    async def receive(self, meeting: HandoverState, following: HandoverState | None, helpers: trio.Nursery) -> None:
        """Do this arm's part of a handover; ``following`` is the next one, in which it may give."""
        await self.come_near(meeting, helpers)
        if meeting.outcome is not None:
            return
        T_tip_block = await self.take(meeting)
        if T_tip_block is None:
            meeting.fail(TransferOutcome.NOT_GRASPED)
            if meeting.T_board_seen is None or not meeting.may_repeat:
                await self.leave()
            return
        meeting.passed = True
        meeting.taken.set()
        await self.wait_for(meeting.released)
        try:
            await self._place(meeting, T_tip_block, following, helpers)
        except Blocked:
            self.table.blocks.pop(meeting.goal.target, None)
            meeting.fail(TransferOutcome.BLOCKED)
            await self.arm.let_go()

    async def _place(
        self, meeting: HandoverState, T_tip_block: SE3, following: HandoverState | None, helpers: trio.Nursery
    ) -> None:
        """Look how the block sits in the jaws while the other arm leaves, bring it to its target and let go."""
        target = meeting.goal.target
        T_tip_block = await self.arm.eyes.see_own(T_tip_block)
        ready = await self.arm.plan(lambda: self.arm.motions.carriage(self.arm.hand.q, T_tip_block, None, target))
        await self.wait_for(meeting.parted)
        self.arm.coordinator.carry(self.arm.name, self.arm.motions.held(T_tip_block))

        def begun(carriage: Carriage) -> None:
            if following is not None and following.giver == self.arm.name:
                self.script.look_ahead(helpers, carriage.path, following.goal)
            elif following is not None and self.settings.looks_ahead:
                self.plan_ahead(carriage.path, following, helpers)

        outcome = await self.script.deliver(T_tip_block, None, target, ready, begun)
        if outcome is not TransferOutcome.DONE:
            meeting.fail(outcome)
        await (self.arm.let_go() if meeting.outcome else self.arm.open())
