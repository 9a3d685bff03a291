"""Two arms over one board: which one is which, and how they start and end together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Sequence

from trocar.errors import TrocarError
from trocar.eval import AgentContext
from trocar.robots.coordinator import Coordinator
from trocar.tasks.peg_transfer.agents.learner import learning
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.start import begin, finish, withdraw
from trocar.tasks.peg_transfer.agents.table import Table


class TwoArms(ABC):
    """What the scripts with two arms share.

    Attributes:
        left: the arm whose base is further left, seen from the camera.
        right: the other.
        table: board and blocks, as both know them.
        coordinator: of both arms.
    """

    def __init__(self, context: AgentContext):
        if len(context.arms) != 2:
            raise TrocarError(f"this variant of peg-transfer needs two arms, and was given {', '.join(context.arms)}")
        self.cell, self.settings, self.goals = context.cell, context.settings, context.goals
        self.table = Table(context)
        self.coordinator = Coordinator(context.cell, context.arms, context.settings.margins)
        arms = [PegArm(context, name, self.table, self.coordinator) for name in context.arms]
        self.left, self.right = sorted(arms, key=lambda arm: float(arm.motions.T_base_board.inverse().translation_m[0]))
        self._gone = 0

    async def run(self) -> None:
        """Wake both arms, find the board, do the transfers, and look once more at the end."""
        if not await begin(self.table, [self.left, self.right], self.first_looks()):
            return
        async with learning([self.left, self.right]):
            await self.transfer_all()

    def first_looks(self) -> Sequence[Callable[[], Awaitable[None]]]:
        """Return the function that looks at the first blocks."""
        return []

    async def leave(self, arm: PegArm) -> None:
        """Let an arm that has finished leave the board, if it can; the last one looks once more."""
        self._gone += 1
        if self._gone == 2:
            await finish(self.table, arm)
        elif not arm.stopped:
            await withdraw(arm)

    @abstractmethod
    async def transfer_all(self) -> None:
        """Do the transfers."""
