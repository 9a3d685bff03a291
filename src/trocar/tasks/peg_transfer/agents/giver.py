"""The arm that picks a block and offers it to the other."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial

import trio

from trocar.geometry import SE3
from trocar.motion import TimedPath
from trocar.robots import TICK_S
from trocar.robots.concurrency import Pending
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents.hand import PARTED_RAD
from trocar.tasks.peg_transfer.agents.meeting import ASIDE_M, MIN_ROOM_M, HandoverState, Offer, Side
from trocar.tasks.peg_transfer.agents.motions import AT_HEIGHT_M, Approach, Joints, end_of, starts_at
from trocar.tasks.peg_transfer.agents.peg_arm import PAUSE_S, PegArm
from trocar.tasks.peg_transfer.agents.unilateral import OneArm, Seen
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp


class Giver(Side):
    """Picks, offers and releases blocks, and puts back those not taken."""

    def __init__(self, arm: PegArm, other: PegArm, script: OneArm):
        super().__init__(arm, other, script)
        self._offering: Pending[tuple[TimedPath, Offer]] = Pending()
        self._kept: SE3 | None = None  # pose in the jaws of a block that is to be offered another way

    async def give(self, meeting: HandoverState, following: HandoverState | None, helpers: trio.Nursery) -> None:
        """Do this arm's part of a handover; ``following`` is the next one, in which it may give again."""
        if following is not None and following.giver != self.arm.name:
            following = None
        meeting.start_s = self.cell.clock.now_s()
        source, T_board_block = meeting.goal.source, None
        T_tip_block, self._kept = self._kept, None
        if T_tip_block is None:
            grasp = await self.script.pick(source, partial(self._plan_ahead, meeting, helpers))
            if not isinstance(grasp, Grasp):
                meeting.fail(grasp)
                await self.arm.let_go()
                return
            T_board_block = self.table.blocks.pop(source)
            T_tip_block = self.arm.motions.gripped(self.arm.hand.q, T_board_block)
        try:
            stands = T_board_block is not None
            offered = await self._offer(meeting, T_tip_block, stands, following, helpers)
        except Blocked:
            if T_board_block is None:
                await self._put_back(T_tip_block, source)
            else:  # the block stands where it did: nothing has moved
                self.table.blocks[source] = T_board_block
                await self.arm.open()
                await self.arm.give_way()
            raise
        if not offered:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not self.arm.holds:
            meeting.fail(TransferOutcome.DROPPED)
        else:
            meeting.offered.set()
            await self.wait_for(meeting.taken)
        if meeting.outcome is not None:
            await self.script.seen.take()
            if T_board_block is None or not await self._keep(meeting):
                await self._put_back(T_tip_block, source)
            return
        await self._part(meeting, following, helpers)

    def _plan_ahead(self, meeting: HandoverState, helpers: trio.Nursery, approach: Approach) -> None:
        """When an approach begins, plan how to offer the block from where the approach ends, and announce the offer."""
        block = self.table.blocks.get(meeting.goal.source)
        if not self.settings.looks_ahead or block is None:
            return
        q = end_of(approach.path)
        T_tip_block = self.arm.motions.gripped(q, block)

        async def plan() -> tuple[TimedPath, Offer] | None:
            found = partial(self._find_offering, q, T_tip_block, meeting)
            offering = await self.arm.plan(found)
            if offering is not None:
                meeting.announce(offering[1].T_board_tip, T_tip_block)
            return offering

        self._offering.start(helpers, plan)

    def _find_offering(self, q: Joints, T_tip_block: SE3, meeting: HandoverState) -> tuple[TimedPath, Offer] | None:
        """Return the motion that lifts a block and brings it to the handover, and the offer; None if there is none."""
        geometry, motions = self.geometry(self.arm, self.other, meeting), self.arm.motions
        offer = geometry.choose_offer(motions.tip(q), T_tip_block)
        if isinstance(offer, str):
            self.cell.log.event("no place", reason=offer)
            return None
        return motions.offering(q, T_tip_block, meeting.goal.source, offer.T_board_tip), offer

    async def _offer(
        self,
        meeting: HandoverState,
        T_tip_block: SE3,
        stands: bool,
        following: HandoverState | None,
        helpers: trio.Nursery,
    ) -> bool:
        """Bring a block to the handover, looking at the next one on the way; return False if no motion does it.

        Args:
            meeting: the handover.
            T_tip_block: pose of the block in the jaws.
            stands: whether it still stands on its peg. Then this arm gives up if the other one holds a block in the air
                and does not move either.
            following: the next handover, if this arm gives then too.
            helpers: run the look at the next block.

        Raises:
            Blocked: the other arm is in the way.
        """
        hand = self.arm.hand
        ready = await self._offering.take()
        if ready is None or not starts_at(ready[0], hand.q):
            ready = await self.arm.plan(lambda: self._find_offering(hand.q, T_tip_block, meeting))
        if ready is None:
            return False
        path, offer = ready

        def begun() -> None:
            meeting.announce(offer.T_board_tip, T_tip_block)
            meeting.begun.set()
            self.script.look_ahead(helpers, path, following and following.goal, self.settings.parts_m)

        for tries in range(2 + self.settings.detours):
            try:
                margin_m = self.settings.meeting_margin_m
                await self.arm.move(path.trajectory, begun=begun, margin_m=margin_m, waits=tries > 0)
                break
            except Blocked:
                if meeting.begun.is_set():  # it was refused by the robot
                    meeting.begun = trio.Event()
                if tries > self.settings.detours or (tries and stands and self._other_hangs_on()):
                    raise
                self.cell.log.event("crowded", arm=self.arm.name)
                if tries:  # the robot's guard waits for nobody: the other arm needs time to leave
                    await self.cell.clock.sleep(PAUSE_S)
                meeting.crowded.set()
        self.cell.log.event("offer", arm=self.arm.name, room_mm=round(1e3 * offer.room_m, 2))
        return True

    def _other_hangs_on(self) -> bool:
        """Return whether the other arm holds a block, and is at rest."""
        resting = not self.cell.robot.setpoint(self.other.name).moving
        return resting and self.arm.coordinator.carries(self.other.name)

    async def _keep(self, meeting: HandoverState) -> bool:
        """Plan to offer a block another way where there was no room to take it as seen; return whether that helps.

        If there is no room then either, it is put back and grasped anew.
        """
        if meeting.T_board_seen is None or not meeting.may_repeat or not self.arm.holds:
            return False
        T_tip_block = self.arm.T_board_tip.inverse() @ meeting.T_board_seen
        find = partial(self._find_offering, self.arm.hand.q, T_tip_block, meeting)
        offering = await self.arm.plan(find)
        if offering is None or offering[1].room_m < MIN_ROOM_M:
            return False
        self._kept = T_tip_block
        self._offering.put(offering)
        return True

    async def _part(self, meeting: HandoverState, following: HandoverState | None, helpers: trio.Nursery) -> None:
        """Release a block that the other arm also holds, rise out of it, and go on to the next block, or aside.

        The jaws open as wide as for a grasp on a peg. When they truly opened by less than 0.05 rad more, the rising arm
        tilted 43 of 77 blocks in the other arm's jaws by more than 3 deg; with more than 0.08 rad, 12 of 92.
        """
        held_rad = self.arm.hand.jaw_rad
        await self.arm.open(self.settings.jaw_open_rad)
        meeting.released.set()
        seen = await self.script.seen.take()
        if seen is not None and following is not None and await self._go_on(meeting, following, seen, helpers):
            return
        self.script.seen.put(seen)
        try:
            risen = await self._risen(max(self.settings.release_rad, held_rad + PARTED_RAD))
        finally:
            meeting.parted.set()
        if not risen:  # sideways, a finger in the hole would take the block along
            return
        try:
            await self.arm.shift((self.own_side * ASIDE_M, 0.0, 0.0), self.settings.meeting_margin_m)
        except Blocked:
            await self.arm.give_way()

    async def _risen(self, narrow_rad: float) -> bool:
        """Rise out of a block that the other arm holds; return whether there was room.

        Jaws that are less open leave more of it, but turn the block more often. The other arm waits at rest meanwhile.
        """
        for jaw_rad in (None, narrow_rad):
            if jaw_rad is not None:
                await self.arm.open(jaw_rad)
            with suppress(Blocked):
                await self.rise(waits=False)
                return True
        self.cell.log.event("stayed", arm=self.arm.name, reason="there was no room to rise")
        return False

    async def _go_on(self, meeting: HandoverState, following: HandoverState, seen: Seen, helpers: trio.Nursery) -> bool:
        """Rise out of the block and approach the next one in one motion; return whether that was possible.

        If the other arm is in the way above the block, this one first goes aside.
        """
        q, up_m, aside_m = self.arm.hand.q, self.settings.parts_m, self.own_side * ASIDE_M
        ways = (
            lambda: self.arm.motions.approach(q, seen.grasp, following.goal.source, up_m),
            lambda: self.arm.motions.approach(q, seen.grasp, following.goal.source, up_m, aside_m),
        )
        ready = seen.approach
        for way in ways:
            if ready is None or not starts_at(ready.path, q):
                ready = await self.arm.plan(way)
            if ready is not None and await self._leave_along(ready, meeting, following, seen.grasp, helpers):
                self.script.seen.put(replace(seen, there=True))
                return True
            ready = None
        return False

    async def _leave_along(
        self,
        approach: Approach,
        meeting: HandoverState,
        following: HandoverState,
        grasp: Grasp,
        helpers: trio.Nursery,
    ) -> bool:
        """Rise out of the block and go on along an approach to the next one; return whether there was room."""
        times_s, risen_m = approach.path.waypoint_times_s, self.arm.height_m + self.settings.parts_m - AT_HEIGHT_M
        ended = trio.Event()

        async def part() -> None:
            while self.arm.height_m < risen_m:
                if ended.is_set():  # the motion was refused, or stopped
                    return
                await self.cell.clock.sleep(TICK_S)
            meeting.parted.set()
            await self.arm.hand.drive_jaw(self.arm.opening_rad(grasp))

        def begun() -> None:
            helpers.start_soon(part)
            self._plan_ahead(following, helpers, approach)

        try:
            await self.arm.move(
                approach.path.trajectory,
                begun=begun,
                margin_m=self.settings.meeting_margin_m,
                contact_s=(0.0, float(times_s[1] - times_s[0])),
                waits=False,  # whether it can leave again is not checked: the other arm goes once this one has risen
            )
        except Blocked:
            self.cell.log.event("parts aside", arm=self.arm.name)
            return False
        finally:
            ended.set()
        await self.arm.hand.settle()
        return True

    async def _put_back(self, T_tip_block: SE3, source: int) -> None:
        """Bring a block that was not taken back to its peg, if it is still in the jaws."""
        if self.arm.holds:
            placed = await self.arm.carry(T_tip_block, None, source)
            if placed is not None:
                self.table.blocks[source] = placed
        await self.arm.let_go()
