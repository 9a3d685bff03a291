"""What one arm does with the transfers that are its own: alone, or beside another arm that does others."""

from __future__ import annotations

from collections.abc import Sequence

from trocar.geometry import SE3
from trocar.tasks.peg_transfer.agents.peg_arm import ArmStopped, PegArm
from trocar.tasks.peg_transfer.agents.traffic import Blocked
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp


class OneArm:
    """One arm's script: its transfers one after the other.

    Attributes:
        arm: what it can do.
        table: what it knows of the board.
        goals: its transfers.
        beside: whether another arm works here too.
    """

    def __init__(self, arm: PegArm, goals: Sequence[Transfer], beside: bool = False):
        self.arm, self.table, self.goals, self.beside = arm, arm.table, goals, beside
        self.cell, self.settings = arm.cell, arm.settings

    async def transfer_all(self) -> None:
        """Do all transfers; an arm that stopped does no more."""
        for goal in self.goals:
            start_s = self.cell.clock.now_s()
            stopped, reason = False, ""
            try:
                outcome = await self._transfer(*goal)
                if outcome not in (TransferOutcome.DONE, TransferOutcome.NO_BLOCK):
                    await self.arm.let_go()
            except Blocked:
                outcome = TransferOutcome.BLOCKED
            except ArmStopped as error:
                stopped, outcome, reason = True, TransferOutcome.ARM_STOPPED, str(error)
            self.note(goal, start_s, outcome, reason)
            if stopped:
                return

    def note(self, goal: Transfer, start_s: float, outcome: TransferOutcome, reason: str = "") -> None:
        """Note how a transfer ended."""
        values = {"reason": reason} if reason else {}
        self.cell.log.event(
            "transfer",
            source=goal.source,
            target=goal.target,
            start_s=round(start_s, 6),
            outcome=outcome.name,
            **values,
        )

    async def _transfer(self, source: int, target: int) -> TransferOutcome:
        """Move one block; every way in which this can end is an outcome."""
        for _ in range(self.settings.rounds):
            grasp = await self.pick(source)
            if not isinstance(grasp, Grasp):
                return grasp
            T_board_block = self.table.blocks.pop(source)
            try:
                return await self._bring(grasp, T_board_block, target)
            except Blocked:  # the block stands where it stood: nothing has moved
                self.table.blocks[source] = T_board_block
                await self.arm.open()
                await self.arm.give_way()
        return TransferOutcome.BLOCKED

    async def _bring(self, grasp: Grasp, T_board_block: SE3, target: int) -> TransferOutcome:
        """Bring a block that is held to its target."""
        place = await self._carry(grasp, T_board_block, target)
        if place is None:
            return TransferOutcome.OUT_OF_REACH
        if not self.arm.holds:
            return TransferOutcome.DROPPED
        await self.arm.open()
        self.table.blocks[target] = place
        return TransferOutcome.DONE

    async def pick(self, source: int) -> Grasp | TransferOutcome:
        """Take hold of the block on a peg; return how, or why not."""
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            grasp = await self._see(source, failed)
            if not isinstance(grasp, Grasp):
                return grasp
            if not await self.arm.go_to(grasp, source):
                return TransferOutcome.OUT_OF_REACH
            if await self.arm.grip(self.arm.gripped(grasp, self.table.blocks[source])):
                return grasp
            jaw_rad = round(self.arm.hand.jaw_rad, 4)
            self.cell.log.event("pick failed", peg=source, attempt=attempt, jaw_rad=jaw_rad)
            failed.append(grasp.candidate)
            await self.arm.let_go()
        return TransferOutcome.NOT_GRASPED

    async def _see(self, source: int, failed: Sequence[int]) -> Grasp | TransferOutcome:
        """Look at a peg; where its block is hidden, go home and look again, and again if another arm may hide it."""
        grasp = await self.arm.see(source, failed)
        for look in range(self.settings.looks if self.beside else 1):
            if isinstance(grasp, Grasp):
                break
            if look == 0:
                await self.arm.go_home()
            else:
                await self.cell.clock.sleep(self.settings.pause_s)
            grasp = await self.arm.see(source, failed)
        return grasp

    async def _carry(self, grasp: Grasp, T_board_block: SE3, target: int) -> SE3 | None:
        """Bring the block to its target; return where it should lie now, or None where no pose is in reach."""
        return await self.arm.carry(self.arm.gripped(grasp, T_board_block), target)
