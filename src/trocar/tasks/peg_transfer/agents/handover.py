"""One arm picks every block and hands it over to the other, which places it (paper, section III: handover)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from math import inf

from trocar.eval import AgentContext
from trocar.robots.concurrency import together
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents.giver import Giver
from trocar.tasks.peg_transfer.agents.peg_arm import ArmStopped, PegArm
from trocar.tasks.peg_transfer.agents.receiver import Receiver
from trocar.tasks.peg_transfer.agents.side import AGAIN, HandoverState
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.agents.two_arms import TwoArms
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome


class Handover(TwoArms):
    """Both arms have a list of jobs: give, or receive. The next block is picked while this one is placed."""

    def __init__(self, context: AgentContext):
        settings = context.settings
        settings = replace(settings, fixed_wrist_when_placing=settings.looks_before_placing)
        super().__init__(replace(context, settings=settings))
        rounds = range(self.settings.rounds)
        self.scripts = {arm.name: OneArm(arm, (), beside=True) for arm in (self.left, self.right)}
        self.appointments = [[HandoverState(goal) for _ in rounds] for goal in self.goals]

    async def transfer_all(self) -> None:
        """Let both arms do their jobs."""
        await together(partial(self._script, self.left, self.right), partial(self._script, self.right, self.left))

    async def _script(self, arm: PegArm, other: PegArm) -> None:
        script = self.scripts[arm.name]
        giver, receiver = Giver(arm, other, script), Receiver(arm, other, script)
        working = True
        for rounds, following in zip(self.appointments, [*self.appointments[1:], None], strict=True):
            gives, ended = self._gives(arm, rounds[0].goal), rounds[-1]
            to_give = following[0] if following and self._gives(arm, following[0].goal) else None
            to_receive = following[0] if following and not to_give else None
            turns, begin_s = rounds[0].turns, self.cell.clock.now_s()
            turns[arm.name] = (begin_s, inf)
            for meeting in rounds:
                if gives:
                    job = partial(giver.give, meeting, to_give)
                else:
                    job = partial(receiver.receive, meeting, to_give, to_receive)
                if working:
                    working = await self._done(arm, job, meeting)
                else:
                    meeting.fail(TransferOutcome.ARM_STOPPED)
                if meeting.passed or meeting.outcome not in AGAIN:
                    ended = meeting
                    break
            turns[arm.name] = (begin_s, self.cell.clock.now_s())
            if not gives:
                outcome = ended.outcome or TransferOutcome.DONE
                if outcome is TransferOutcome.NO_BLOCK and rounds[0].outcome is TransferOutcome.DROPPED:
                    outcome = TransferOutcome.DROPPED  # and it has not slipped back to its peg
                until_now = {
                    name: (start_s, min(end_s, turns[arm.name][1])) for name, (start_s, end_s) in turns.items()
                }
                script.note(ended.goal, rounds[0].start_s, outcome, ended.reason, until_now)
        await self.leave(arm)

    async def _done(self, arm: PegArm, job: Callable[[], Awaitable[None]], meeting: HandoverState) -> bool:
        """Do an arm's part of a meeting; return whether both arms can go on."""
        try:
            await job()
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
        except ArmStopped as error:
            arm.stopped = True
            if not meeting.parted.is_set():  # else only the other arm holds the block
                meeting.fail(TransferOutcome.ARM_STOPPED, str(error))
        return not arm.stopped and meeting.outcome is not TransferOutcome.ARM_STOPPED

    def _gives(self, arm: PegArm, goal: Transfer) -> bool:
        """Return whether an arm gives: the one on the side of the source does."""
        pegs = self.table.board.pegs_m
        leftwards = pegs[goal.target, 0] < pegs[goal.source, 0]
        return (arm is self.right) == bool(leftwards)
