"""Two arms over one board: which is which, and how they start and end together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import Any

import trio

from trocar.errors import TrocarError
from trocar.tasks.kit import Brief
from trocar.tasks.peg_transfer.agents.peg_arm import ArmStopped, PegArm
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.agents.traffic import Blocked, Traffic


class TwoArms(ABC):
    """What the scripts with two arms share.

    Attributes:
        left: the arm whose base is further left, seen from the camera.
        right: the other.
        table: board and blocks, as both know them.
    """

    def __init__(self, brief: Brief):
        if len(brief.arms) != 2:
            raise TrocarError(f"this variant of peg-transfer needs two arms, and was given {', '.join(brief.arms)}")
        self.cell, self.settings, self.goals = brief.cell, brief.settings, brief.goals
        self.table = Table(brief)
        self.traffic = Traffic(brief.cell, brief.known.block, brief.settings)
        arms = [PegArm(brief, name, self.table, self.traffic) for name in brief.arms]
        self.left, self.right = sorted(arms, key=lambda arm: float(arm.T_base_board.inverse().translation_m[0]))

    async def run(self) -> None:
        """Wake both arms, find the board, do the transfers, and look once more at the end."""
        await together(self.left.wake, self.right.wake)
        if not await self.table.find_board(self.right.hand):
            return
        await self.transfer_all()
        await self.table.check(self.right.hand)

    @abstractmethod
    async def transfer_all(self) -> None:
        """Do the transfers."""


async def together(*scripts: Callable[[], Awaitable[Any]]) -> None:
    """Run scripts side by side; return when all have ended."""
    async with trio.open_nursery() as nursery:
        for script in scripts:
            nursery.start_soon(script)


async def withdraw(arm: PegArm) -> None:
    """Let an arm that has nothing to do leave the board, if it can."""
    try:
        await arm.go_home()
    except (Blocked, ArmStopped) as error:
        arm.cell.log.event("stayed", arm=arm.name, reason=str(error) or type(error).__name__)
