"""The arm that picks a block and offers it to the other."""

from __future__ import annotations

import numpy as np

from trocar.geometry import SE3
from trocar.tasks.peg_transfer.agents.meeting import choose_offer
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm, raised
from trocar.tasks.peg_transfer.agents.side import Appointment, Side
from trocar.tasks.peg_transfer.agents.traffic import Blocked
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp


class Giver(Side):
    """Picks, offers, lets go, and puts back what nobody took."""

    def __init__(self, arm: PegArm, other: PegArm):
        super().__init__(arm, other)
        self.script = OneArm(arm, (), beside=True)

    async def give(self, meeting: Appointment) -> None:
        """Do this arm's part of a handover."""
        meeting.start_s = self.cell.clock.now_s()
        self.arm.hands_over = True
        grasp = await self.script.pick(meeting.goal.source)
        if not isinstance(grasp, Grasp):
            meeting.fail(grasp)
            await self.arm.let_go()
            return
        T_board_block = self.table.blocks.pop(meeting.goal.source)
        T_tip_block = self.arm.gripped(grasp, T_board_block)
        try:
            offered = await self._offer(meeting, T_tip_block)
        except Blocked:  # the block stands where it stood: nothing has moved
            self.table.blocks[meeting.goal.source] = T_board_block
            await self.arm.let_go()
            raise
        if not offered:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not self.arm.holds:
            meeting.fail(TransferOutcome.DROPPED)
        else:
            meeting.offered.set()
            await self.wait_for(meeting.taken)
        if meeting.outcome is not None:
            await self._put_back(T_tip_block, meeting.goal.source)
            return
        await self._part(meeting)

    async def _offer(self, meeting: Appointment, T_tip_block: SE3) -> bool:
        """Lift a block and bring it to where it is handed over."""

        def motion():
            offer = choose_offer(
                *self.partners(self.arm, self.other),
                self.table.T_world_board,
                self.arm.T_board_tip,
                T_tip_block,
                self.table.block,
                np.array(self.settings.meeting_m),
                self.ways(),
            )
            if isinstance(offer, str):
                self.cell.log.event("no place", reason=offer)
                return None
            lifted = raised(self.arm.T_board_tip, self.arm.height_m + self.settings.lift_m)
            points = [self.arm.hand.q, self.arm.ik(lifted), self.arm.ik(offer.T_board_tip)]
            return self.arm.through(points), offer

        planned = await self.arm.plan(motion)
        if planned is None:
            return False
        await self.arm.move(planned[0])
        await self.arm.hand.settle()
        meeting.T_board_block = planned[1].T_board_tip @ T_tip_block
        self.cell.log.event("offer", arm=self.arm.name, room_mm=round(1e3 * planned[1].room_m, 2))
        return True

    async def _part(self, meeting: Appointment) -> None:
        """Let go of a block that the other arm holds too, rise out of it, and go aside."""
        try:
            await self.arm.open(self.settings.release_rad)
            await self.rise()
        except Blocked:
            self.cell.log.event("stayed", arm=self.arm.name, reason="there was no room to rise")
        finally:
            meeting.parted.set()
        try:
            await self.arm.shift((self.own_side * self.settings.aside_m, 0.0, 0.0), self.settings.meeting_margin_m)
        except Blocked:
            await self.arm.give_way()

    async def _put_back(self, T_tip_block: SE3, source: int) -> None:
        """Bring a block that nobody took back to where it was, if it is still there."""
        if self.arm.holds:
            placed = await self.arm.carry(T_tip_block, source)
            if placed is not None:
                self.table.blocks[source] = placed
        await self.arm.let_go()
