"""Two arms over one board: in parallel, or one hands every block over to the other (paper, section III)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from functools import partial
from itertools import pairwise
from math import inf

import trio

from trocar.errors import ArmStopped, InvalidInput
from trocar.eval import AgentContext
from trocar.robots.concurrency import together, with_helpers
from trocar.robots.coordinator import Blocked, Coordinator
from trocar.tasks.peg_transfer.agents.giver import Giver
from trocar.tasks.peg_transfer.agents.learner import learning
from trocar.tasks.peg_transfer.agents.meeting import HandoverState
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.receiver import Receiver
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.agents.unilateral import OneArm, begin, finish, withdraw
from trocar.tasks.peg_transfer.goals import PAIRS, Transfer, TransferOutcome

LEFT_GOALS = frozenset(left for left, _ in PAIRS)
AGAIN = (TransferOutcome.BLOCKED, TransferOutcome.NOT_GRASPED, TransferOutcome.DROPPED)
"""Outcomes of a handover after which another try is worthwhile: the block is back where it was, or has slipped back."""


class TwoArms(ABC):
    """Base of the agents with two arms.

    Attributes:
        left: the arm whose base is further left, as seen by the camera.
        right: the other.
        table: board and blocks, as both know them.
        coordinator: of both arms.
        looks: functions that look at the first blocks while the wrists are exercised.
    """

    def __init__(self, context: AgentContext):
        if len(context.arms) != 2:
            given = ", ".join(context.arms)
            raise InvalidInput("this variant of peg-transfer", f"needs two arms, and was given {given}")
        self.cell, self.settings, self.goals = context.cell, context.settings, context.goals
        self.table = Table(context)
        self.coordinator = Coordinator(context.cell, context.arms, context.settings.margins)
        arms = [PegArm(context, name, self.table, self.coordinator) for name in context.arms]
        self.left, self.right = sorted(arms, key=lambda arm: float(arm.motions.T_base_board.inverse().translation_m[0]))
        self.looks: list[Callable[[], Awaitable[None]]] = []
        self._gone = 0

    async def run(self) -> None:
        """Wake both arms, find the board, do the transfers, and look once more at the end."""
        if not await begin(self.table, [self.left, self.right], self.looks):
            return
        async with learning([self.left, self.right]):
            await together(partial(self._script, self.left), partial(self._script, self.right))

    async def _script(self, arm: PegArm) -> None:
        """Let an arm do its work and then leave the board, if it can; the last one looks once more."""
        await self.work(arm)
        self._gone += 1
        if self._gone == 2:
            await finish(self.table, arm)
        elif not arm.stopped:
            await withdraw(arm)

    @abstractmethod
    async def work(self, arm: PegArm) -> None:
        """Do an arm's part of all transfers."""


class Bilateral(TwoArms):
    """Two scripts, one per arm; they share the board, the camera and the coordinator, and keep pace."""

    def __init__(self, context: AgentContext):
        super().__init__(context)
        lefts = [goal for goal in self.goals if goal in LEFT_GOALS]
        rights = [goal for goal in self.goals if goal not in LEFT_GOALS]
        self.scripts = {arm.name: OneArm(arm, own, True) for arm, own in ((self.left, lefts), (self.right, rights))}
        self.looks = [partial(script.look_first, script.goals) for script in self.scripts.values()]

    async def work(self, arm: PegArm) -> None:
        """Do an arm's own transfers."""
        await self.scripts[arm.name].transfer_all()
        self.coordinator.reached(arm.name)


class Handover(TwoArms):
    """Each arm gives or receives every block; the next one is picked while the previous one is placed."""

    def __init__(self, context: AgentContext):
        super().__init__(context)
        rounds, x_m = range(self.settings.rounds), self.table.board.pegs_m[:, 0]
        giver = {goal: self.right if x_m[goal.target] < x_m[goal.source] else self.left for goal in self.goals}
        following = {goal: after.source for goal, after in pairwise(self.goals) if giver[goal] is giver[after]}
        self.appointments = [
            [HandoverState(goal, giver[goal].name, following.get(goal), number + 1 < len(rounds)) for number in rounds]
            for goal in self.goals
        ]
        self.scripts = {arm.name: OneArm(arm, (), beside=True) for arm in (self.left, self.right)}
        self._chosen: list[trio.Event] = []
        if self.goals:
            self.looks = [partial(self.scripts[giver[self.goals[0]].name].look_first, self.goals)]

    async def work(self, arm: PegArm) -> None:
        """Give or receive the block of each transfer: the arm on the side of the source gives."""
        script, other = self.scripts[arm.name], self.left if arm is self.right else self.right
        giver, receiver = Giver(arm, other, script), Receiver(arm, other, script)
        working = True
        for number in range(len(self.goals)):
            rounds = await self._appointment(number)
            following = await self._appointment(number + 1) if number + 1 < len(self.goals) else [None]
            gives, ended = rounds[0].giver == arm.name, rounds[-1]
            turns, begin_s = rounds[0].turns, self.cell.clock.now_s()
            turns[arm.name] = (begin_s, inf)
            for meeting in rounds:
                job = partial(giver.give if gives else receiver.receive, meeting, following[0])
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
                    outcome = TransferOutcome.DROPPED  # the block has not slipped back to its peg
                now_s = turns[arm.name][1]
                until_now = {name: (start_s, min(end_s, now_s)) for name, (start_s, end_s) in turns.items()}
                script.note(ended.goal, rounds[0].start_s, outcome, ended.reason, until_now)

    async def _appointment(self, number: int) -> list[HandoverState]:
        """Return the meetings for a transfer in order; which one it is, a person may choose.

        The one after the present is chosen as well, since the arm that gives goes on to it without a stop.
        """
        if number < len(self._chosen):  # by the other arm
            if not self._chosen[number].is_set():
                await self._chosen[number].wait()
            return self.appointments[number]
        self._chosen.append(trio.Event())
        left = self.appointments[number:]
        giver = {rounds[0].goal: rounds[0].giver for rounds in left}
        then = "then " if number else ""

        def told(goal: Transfer) -> tuple[str, str]:
            return giver[goal], f"{then}hands over the block on peg {goal.source}, for peg {goal.target}"

        chosen = await self.table.choose([rounds[0].goal for rounds in left], told)
        self.appointments.insert(number, self.appointments.pop(number + chosen))
        self._chosen[number].set()
        return self.appointments[number]

    async def _done(self, arm: PegArm, job: Callable[[trio.Nursery], Awaitable[None]], meeting: HandoverState) -> bool:
        """Do an arm's part of a meeting; return whether both arms can go on."""
        try:
            await with_helpers(job)
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
        except ArmStopped as error:
            arm.stopped = True
            if not meeting.parted.is_set():  # else only the other arm holds the block
                meeting.fail(TransferOutcome.ARM_STOPPED, str(error))
        return not arm.stopped and meeting.outcome is not TransferOutcome.ARM_STOPPED
