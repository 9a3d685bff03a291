"""Two arms transfer blocks at once, each on its side where it can (paper, section III: parallel bilateral)."""

from __future__ import annotations

from trocar.tasks.kit import Brief
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.agents.two_arms import TwoArms, together, withdraw
from trocar.tasks.peg_transfer.goals import PAIRS

LEFT_GOALS = frozenset(left for left, _ in PAIRS)


class Bilateral(TwoArms):
    """Two scripts, one an arm; they share the board, the camera and the traffic, and do not wait for each other."""

    def __init__(self, brief: Brief):
        super().__init__(brief)
        self.scripts = (
            OneArm(self.left, [goal for goal in self.goals if goal in LEFT_GOALS], beside=True),
            OneArm(self.right, [goal for goal in self.goals if goal not in LEFT_GOALS], beside=True),
        )

    async def transfer_all(self) -> None:
        """Let both arms do their transfers; one that has done withdraws."""
        await together(*(self._script(script) for script in self.scripts))

    def _script(self, script: OneArm):
        async def run() -> None:
            await script.transfer_all()
            await withdraw(script.arm)

        return run
