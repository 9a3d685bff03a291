"""The script of one arm that does its own transfers, alone or beside another arm (paper, section IV)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import trio

from trocar.errors import ArmStopped
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.motion import TimedPath
from trocar.perception.image import RgbdImage
from trocar.robots.concurrency import Pending, together, with_helpers
from trocar.robots.coordinator import Blocked, Coordinator
from trocar.tasks.peg_transfer.agents.learner import learning
from trocar.tasks.peg_transfer.agents.motions import Approach, Carriage, end_of
from trocar.tasks.peg_transfer.agents.peg_arm import PAUSE_S, PegArm
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp


async def begin(table: Table, arms: Sequence[PegArm], looks: Sequence[Callable[[], Awaitable[None]]]) -> bool:
    """Exercise the arms' wrists and find the board; return whether it was found.

    With ``looks_ahead``, the board and the first blocks (``looks``) are looked at during the exercise, while the arms
    are out of the camera's view.
    """
    wakes, hand = [arm.exercise_wrist for arm in arms], arms[-1].hand
    if not table.settings.looks_ahead:
        await together(*wakes)
        return await table.find_board(hand)
    found: list[bool] = []

    async def look() -> None:
        found.append(await table.find_board(hand))
        if found[0]:
            for first in looks:
                await first()

    await together(*wakes, look)
    return found[0]


async def finish(table: Table, arm: PegArm) -> None:
    """Let the last arm go home, if it can, and check that the blocks are where they were set down.

    With ``looks_ahead``, the image is taken on the way; if it does not show all blocks, another is taken at home.
    """

    async def script(helpers: trio.Nursery) -> bool | None:
        checked: Pending[bool] = Pending()

        async def look(path: TimedPath) -> bool:
            # halfway from over the pegs to home, the arm no longer hides a block
            await table.cell.clock.sleep(float(path.waypoint_times_s[-2:].mean() - path.waypoint_times_s[0]))
            return await table.check(arm.hand)

        def begun(path: TimedPath) -> None:
            if table.settings.looks_ahead:
                checked.start(helpers, lambda: look(path))

        await withdraw(arm, begun)
        return await checked.take()

    if arm.stopped or not await with_helpers(script):
        await table.check(arm.hand)


async def withdraw(arm: PegArm, begun: Callable[[TimedPath], None] | None = None) -> None:
    """Let an idle arm leave the board, or note why it cannot."""
    try:
        await arm.go_home(begun)
    except (Blocked, ArmStopped) as error:
        arm.cell.log.event("stayed", arm=arm.name, reason=str(error) or type(error).__name__)


HOLDS, LEFT_SOURCE = 0.5, 1.0
"""Steps at which two arms wait for each other, as shares of a transfer: the block is held; it leaves its source. A step
of a trial is the transfer's number plus such a share."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A block that was looked at while the arm was still busy with the previous one."""

    source: int  # its peg
    grasp: Grasp  # how to grasp it
    approach: Approach | None  # how to get there from where the arm was going; None: to be planned
    there: bool = False  # whether the arm has already arrived there


class OneArm:
    """One arm's script: its transfers one after the other.

    Attributes:
        arm: the arm and its actions.
        table: board and blocks, as last seen.
        goals: its transfers, in the order in which they are done.
        beside: whether another arm works here too, with which this one keeps pace.
        seen: the next block, if it was looked at beforehand.
    """

    def __init__(self, arm: PegArm, goals: Sequence[Transfer], beside: bool):
        self.arm, self.table, self.goals, self.beside = arm, arm.table, [*goals], beside
        self.cell, self.settings = arm.cell, arm.settings
        self.seen: Pending[Seen] = Pending()

    async def transfer_all(self) -> None:
        """Do all transfers; if the arm stops, note the rest as failed."""
        for number in range(len(self.goals)):
            chosen = await self.table.choose(self.goals[number:], self._told)
            self.goals.insert(number, self.goals.pop(number + chosen))
            start_s = self.cell.clock.now_s()
            reason = ""
            try:
                outcome = await with_helpers(partial(self._transfer, number))
                if outcome not in (TransferOutcome.DONE, TransferOutcome.NO_BLOCK):
                    await self.arm.let_go()
            except Blocked:
                outcome = TransferOutcome.BLOCKED
            except ArmStopped as error:
                self.arm.stopped = True
                outcome, reason = TransferOutcome.ARM_STOPPED, str(error)
            self._come(number + LEFT_SOURCE)
            self.note(self.goals[number], start_s, outcome, reason)
            if self.arm.stopped:
                for goal in self.goals[number + 1 :]:
                    self.note(goal, self.cell.clock.now_s(), TransferOutcome.ARM_STOPPED, reason)
                return

    def _told(self, goal: Transfer) -> tuple[str, str]:
        return self.arm.name, f"brings the block on peg {goal.source} to peg {goal.target}"

    def note(
        self,
        goal: Transfer,
        start_s: float,
        outcome: TransferOutcome,
        reason: str = "",
        turns: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Note how a transfer ended; ``turns``: begin and end of each arm's part, None if this arm did it alone."""
        turns = {self.arm.name: (start_s, self.cell.clock.now_s())} if turns is None else turns
        self.cell.log.event(
            "transfer",
            goal=self.arm.goals.index(goal),
            turns={name: [round(time_s, 6) for time_s in times] for name, times in turns.items()},
            source=goal.source,
            target=goal.target,
            start_s=round(start_s, 6),
            outcome=outcome.name,
            **({"reason": reason} if reason else {}),
        )

    async def look_first(self, goals: Sequence[Transfer]) -> None:
        """Look at the first block of these transfers while the arm is still waking."""
        if goals:
            source = goals[0].source
            grasp = await self.arm.eyes.see(source)
            self.seen.put(Seen(source, grasp, None) if isinstance(grasp, Grasp) else None)

    def look_ahead(self, helpers: trio.Nursery, path: TimedPath, goal: Transfer | None, rise_m: float = 0.0) -> None:
        """Look at the next transfer's block while the arm moves, if the settings say so, and plan how to get there."""
        if self.settings.looks_ahead and goal is not None:
            self.seen.start(helpers, partial(self._look_on_the_way, path, goal.source, rise_m))

    async def _look_on_the_way(self, path: TimedPath, source: int, rise_m: float) -> Seen | None:
        """Look at a block during a motion, and plan the approach from the motion's end, first up by ``rise_m``.

        Three images are taken, the last one when the arm is over its target. If an arm hides the block in the last one,
        an earlier one may show it.
        """
        clock, hand, begin_s = self.cell.clock, self.arm.hand, self.cell.clock.now_s()
        over = -1 if self.settings.looks_before_placing else -2  # the last waypoint is over the target, or down at it
        down_s = float(path.waypoint_times_s[over] - path.waypoint_times_s[0])
        images: list[RgbdImage] = []
        for after_s in (0.0, down_s / 2, down_s):
            await clock.sleep(max(0.0, begin_s + after_s - clock.now_s()))
            images.append(await self.table.capture(hand))
        for image in reversed(images):
            grasp = await self.arm.eyes.look(image, source)
            if isinstance(grasp, Grasp):
                planned = partial(self.arm.motions.approach, end_of(path), grasp, source, rise_m)
                return Seen(source, grasp, await self.arm.plan(planned))
        return None

    def _come(self, step: float) -> None:
        if self.beside:
            self.arm.coordinator.reached(self.arm.name, step)

    async def _keep_pace(self, step: float) -> None:
        if self.beside:
            await self.arm.coordinator.wait_for_others(self.arm.name, step, self.settings.pace_s)

    async def _transfer(self, number: int, helpers: trio.Nursery) -> TransferOutcome:
        """Move one block and return the outcome.

        A block that was dropped is searched for at its source, to which it slips back if it is lost during the lift.
        """
        goal, outcome = self.goals[number], TransferOutcome.BLOCKED
        await self._keep_pace(number - 1 + LEFT_SOURCE)
        for _ in range(self.settings.rounds):
            carriage: Pending[Carriage] = Pending()
            grasp = await self.pick(goal.source, partial(self._plan_carriage, goal, carriage, helpers))
            if not isinstance(grasp, Grasp):
                return outcome if outcome is TransferOutcome.DROPPED else grasp
            T_board_block = self.table.blocks.pop(goal.source)
            try:
                outcome = await self._bring(number, T_board_block, carriage, helpers)
            except Blocked:  # the block stands where it stood: nothing has moved
                self.table.blocks[goal.source] = T_board_block
                self.table.blocks.pop(goal.target, None)
                await self.arm.open()
                await self.arm.give_way()
                continue
            if outcome is not TransferOutcome.DROPPED:
                return outcome
            await self.arm.let_go()
        return outcome

    async def _bring(
        self, number: int, T_board_block: SE3, carriage: Pending[Carriage], helpers: trio.Nursery
    ) -> TransferOutcome:
        """Bring a held block to its target; on the way down, look at the next one."""
        T_tip_block = self.arm.motions.gripped(self.arm.hand.q, T_board_block)
        goal, following = self.goals[number], next(iter(self.goals[number + 1 :]), None)
        self._come(number + HOLDS)
        await self._keep_pace(number + HOLDS)
        ready = await carriage.take()

        def begun(carriage: Carriage) -> None:
            self._come(number + LEFT_SOURCE)
            self.look_ahead(helpers, carriage.path, following)

        outcome = await self.deliver(T_tip_block, goal.source, goal.target, ready, begun)
        if outcome is TransferOutcome.DROPPED:
            await self.seen.take()  # a dropped block may be anywhere now
        elif outcome is TransferOutcome.DONE:
            await self.before_release(goal)
            await self.arm.open()
        return outcome

    async def deliver(
        self,
        T_tip_block: SE3,
        source: int | None,
        target: int,
        ready: Carriage | None,
        begun: Callable[[Carriage], None],
    ) -> TransferOutcome:
        """Carry a block to its target; if the outcome is DONE, the jaws still hold it there.

        ``source`` is the peg on which it still stands; None: it is in the air.
        """

        def begins(carriage: Carriage) -> None:
            self.table.blocks[target] = carriage.T_board_placed
            begun(carriage)

        place = await self.arm.carry(T_tip_block, source, target, ready, begins)
        if place is None:
            return TransferOutcome.OUT_OF_REACH
        if not self.arm.holds:
            del self.table.blocks[target]
            return TransferOutcome.DROPPED
        self.table.blocks[target] = place
        return TransferOutcome.DONE

    async def before_release(self, goal: Transfer) -> None:
        """Do nothing: a hook for other agents, called when a block is at its target and still in the jaws."""

    def _plan_carriage(
        self, goal: Transfer, carriage: Pending[Carriage], helpers: trio.Nursery, approach: Approach
    ) -> None:
        """When an approach begins, plan how to carry the block from where the approach ends."""
        block = self.table.blocks.get(goal.source)
        if not self.settings.looks_ahead or block is None:
            return
        motions, q = self.arm.motions, end_of(approach.path)
        found = partial(motions.carriage, q, motions.gripped(q, block), goal.source, goal.target)
        carriage.start(helpers, partial(self.arm.plan, found))

    async def pick(self, source: int, on_the_way: Callable[[Approach], None] | None = None) -> Grasp | TransferOutcome:
        """Take hold of the block on a peg; return the grasp, or why it failed.

        ``on_the_way`` is called with the approach when it begins.
        """
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            seen = await self.seen.take()
            if seen is None or seen.source != source or failed:
                grasp = await self._see(source, failed)
                if not isinstance(grasp, Grasp):
                    return grasp
                seen = Seen(source, grasp, None)
            grasp = seen.grasp
            if not seen.there and not await self.arm.go_to(grasp, source, seen.approach, on_the_way):
                return TransferOutcome.OUT_OF_REACH
            if await self.arm.grip(self.arm.motions.gripped(self.arm.hand.q, self.table.blocks[source])):
                return grasp
            jaw_rad = round(self.arm.hand.jaw_rad, 4)
            self.cell.log.event("pick failed", peg=source, attempt=attempt, jaw_rad=jaw_rad)
            failed.append(grasp.candidate)
            await self.arm.let_go()
            if self.settings.learns_offset:
                await self.arm.look_at_tip(grasp)
        return TransferOutcome.NOT_GRASPED

    async def _see(self, source: int, failed: Sequence[int]) -> Grasp | TransferOutcome:
        """Look at a peg; if its block is hidden, go home and look again, repeatedly if another arm may hide it."""
        grasp = await self.arm.eyes.see(source, failed)
        for look in range(self.settings.looks if self.beside else 1):
            if isinstance(grasp, Grasp):
                break
            if look == 0:
                await self.arm.go_home()
            else:
                await self.cell.clock.sleep(PAUSE_S)
            grasp = await self.arm.eyes.see(source, failed)
        return grasp


class Unilateral(OneArm):
    """One arm that moves one block after the other."""

    def __init__(self, context: AgentContext):
        table = Table(context)
        coordinator = Coordinator(context.cell, context.arms[:1], context.settings.margins)
        super().__init__(PegArm(context, context.arms[0], table, coordinator), context.goals, beside=False)

    async def run(self) -> None:
        """Do the transfers one after the other, and look once more at the end."""
        if not await begin(self.table, [self.arm], [partial(self.look_first, self.goals)]):
            return
        async with learning([self.arm]):
            await self.transfer_all()
            await finish(self.table, self.arm)
