"""The arm that takes a block from the other and places it."""

from __future__ import annotations

from functools import partial

import trio

from trocar.geometry import SE3
from trocar.robots.concurrency import with_helpers
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents.motions import Carriage
from trocar.tasks.peg_transfer.agents.side import HandoverState
from trocar.tasks.peg_transfer.agents.taker import Taker
from trocar.tasks.peg_transfer.goals import TransferOutcome


class Receiver(Taker):
    """Waits above, looks, takes the block, looks again, places it."""

    async def receive(
        self, meeting: HandoverState, to_give: HandoverState | None, to_receive: HandoverState | None
    ) -> None:
        """Do this arm's part of a handover.

        Args:
            meeting: this one.
            to_give: the next one, if this arm gives there.
            to_receive: the next one, if it receives there too.
        """
        await with_helpers(partial(self._receive, meeting, to_give, to_receive))

    async def _receive(
        self,
        meeting: HandoverState,
        to_give: HandoverState | None,
        to_receive: HandoverState | None,
        helpers: trio.Nursery,
    ) -> None:
        await self.come_near(meeting, helpers)
        if meeting.outcome is not None:
            return
        T_tip_block = await self.take(meeting)
        if T_tip_block is None:
            meeting.fail(TransferOutcome.NOT_GRASPED)
            await self.leave()
            return
        meeting.passed = True
        meeting.taken.set()
        await self.wait_for(meeting.released)
        try:
            await self._place(meeting, T_tip_block, to_give, to_receive, helpers)
        except Blocked:
            self.table.blocks.pop(meeting.goal.target, None)
            meeting.fail(TransferOutcome.BLOCKED)
            await self.arm.let_go()

    async def _place(
        self,
        meeting: HandoverState,
        T_tip_block: SE3,
        to_give: HandoverState | None,
        to_receive: HandoverState | None,
        helpers: trio.Nursery,
    ) -> None:
        """Look how the block sits in the jaws while the other arm leaves, bring it to its target and let go."""
        target = meeting.goal.target
        T_tip_block = await self.arm.eyes.see_own(T_tip_block)
        ready = await self.arm.plan(lambda: self.arm.motions.carriage(self.arm.hand.q, T_tip_block, None, target))
        await self.wait_for(meeting.parted)
        self.arm.coordinator.carry(self.arm.name, self.arm.motions.held(T_tip_block))

        def begun(carriage: Carriage) -> None:
            self.table.blocks[target] = carriage.T_board_placed
            if self.settings.looks_ahead and to_give is not None:
                self.script.seen.start(helpers, partial(self.script.look_ahead, carriage.path, to_give.goal.source))
            if self.settings.looks_ahead and to_receive is not None:
                self.plan_ahead(carriage.path, to_receive, helpers)

        place = await self.arm.carry(T_tip_block, target, ready, begun)
        if place is None:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not self.arm.holds:
            del self.table.blocks[target]
            meeting.fail(TransferOutcome.DROPPED)
        else:
            self.table.blocks[target] = place
        if meeting.outcome is not None:
            await self.arm.let_go()
            return
        await self.arm.open()
