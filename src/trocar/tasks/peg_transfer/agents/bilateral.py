"""Two arms transfer blocks at once, each on its side where it can (paper, section III: parallel bilateral)."""

from __future__ import annotations

from trocar.eval import AgentContext
from trocar.robots.concurrency import together
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.agents.two_arms import TwoArms
from trocar.tasks.peg_transfer.goals import PAIRS

LEFT_GOALS = frozenset(left for left, _ in PAIRS)


class Bilateral(TwoArms):
    """Two scripts, one per arm; they share the board, the camera and the coordinator, and keep pace."""

    def __init__(self, context: AgentContext):
        super().__init__(context)
        lefts = [goal for goal in self.goals if goal in LEFT_GOALS]
        rights = [goal for goal in self.goals if goal not in LEFT_GOALS]
        self.scripts = (
            OneArm(self.left, lefts, beside=True, keeps_pace=True),
            OneArm(self.right, rights, beside=True, keeps_pace=True),
        )

    def first_looks(self):
        """Return the function that looks at both arms' first blocks."""
        return [script.look_first for script in self.scripts]

    async def transfer_all(self) -> None:
        """Let both arms do their transfers; an arm that has finished leaves."""
        await together(*(self._script(script) for script in self.scripts))

    def _script(self, script: OneArm):
        async def run() -> None:
            await script.transfer_all()
            self.coordinator.reached(script.arm.name)
            await self.leave(script.arm)

        return run
