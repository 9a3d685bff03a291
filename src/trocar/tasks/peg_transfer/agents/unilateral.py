"""One arm transfers all blocks: see, grasp, carry, place, check (paper, section IV)."""

from __future__ import annotations

from trocar.eval import AgentContext
from trocar.robots.coordinator import Coordinator
from trocar.tasks.peg_transfer.agents.learner import learning
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.settings import Settings
from trocar.tasks.peg_transfer.agents.start import begin, finish
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.agents.transfers import OneArm

__all__ = ["Settings", "Unilateral"]


class Unilateral(OneArm):
    """One arm, one block after the other."""

    def __init__(self, context: AgentContext):
        table = Table(context)
        coordinator = Coordinator(context.cell, context.arms[:1], context.settings.margins)
        super().__init__(PegArm(context, context.arms[0], table, coordinator), context.goals)

    async def run(self) -> None:
        """Do the transfers one after the other, and look once more at the end."""
        if not await begin(self.table, [self.arm], [self.look_first]):
            return
        async with learning([self.arm]):
            await self.transfer_all()
            await finish(self.table, self.arm)
