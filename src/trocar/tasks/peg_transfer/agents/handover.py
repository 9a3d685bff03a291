"""One arm picks every block and hands it over to the other, which places it (paper, section III: handover)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import trio

from trocar.geometry import SE3, SO3
from trocar.tasks.kit import Brief
from trocar.tasks.peg_transfer.agents.meeting import Partner, Ways, choose_offer, choose_taking
from trocar.tasks.peg_transfer.agents.peg_arm import ArmStopped, PegArm, raised, yaw_of
from trocar.tasks.peg_transfer.agents.traffic import Blocked
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.agents.two_arms import TwoArms, together, withdraw
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp
from trocar.tasks.peg_transfer.places import held_block

AGAIN = (TransferOutcome.BLOCKED, TransferOutcome.NOT_GRASPED)
"""Ends of a meeting after which it is worth another try: the block is back where it was."""


@dataclass(eq=False)
class Meeting:
    """What the two scripts tell each other about one transfer.

    Attributes:
        goal: the transfer.
        start_s: when the giving arm began.
        T_board_block: where the block is offered, as the giving arm's joints tell.
        passed: whether the receiving arm has had the block.
        offered: the giving arm holds the block still, and waits.
        taken: the receiving arm holds it too.
        parted: the giving arm has let go and gone.
        outcome: why nothing comes of it; None: it goes well.
        reason: a sentence, where there is one.
    """

    goal: Transfer
    start_s: float = 0.0
    T_board_block: SE3 | None = None
    outcome: TransferOutcome | None = None
    reason: str = ""
    passed: bool = False
    offered: trio.Event = field(default_factory=trio.Event)
    taken: trio.Event = field(default_factory=trio.Event)
    parted: trio.Event = field(default_factory=trio.Event)

    def fail(self, outcome: TransferOutcome, reason: str = "") -> None:
        """End it."""
        if self.outcome is None:
            self.outcome, self.reason = outcome, reason
        for event in (self.offered, self.taken, self.parted):
            event.set()


class Handover(TwoArms):
    """Both arms have a list of jobs: give, or receive. The next block is picked while this one is placed."""

    def __init__(self, brief: Brief):
        super().__init__(brief)
        self.meetings = [[Meeting(goal) for _ in range(self.settings.rounds)] for goal in self.goals]

    async def transfer_all(self) -> None:
        """Let both arms do their jobs."""
        await together(partial(self._script, self.left, self.right), partial(self._script, self.right, self.left))

    async def _script(self, arm: PegArm, other: PegArm) -> None:
        script = OneArm(arm, (), beside=True)
        working = True
        for rounds in self.meetings:
            gives = self._gives(arm, rounds[0].goal)
            job = partial(self._give, script) if gives else self._receive
            for meeting in rounds:
                working = working and await self._done(arm, partial(job, arm, other, meeting), meeting)
                if not working:
                    meeting.fail(TransferOutcome.ARM_STOPPED)
                if meeting.passed or meeting.outcome not in AGAIN:
                    break
            if not gives:
                script.note(meeting.goal, rounds[0].start_s, meeting.outcome or TransferOutcome.DONE, meeting.reason)
        if not arm.stopped:
            await withdraw(arm)

    async def _done(self, arm: PegArm, job: Callable[[], Awaitable[None]], meeting: Meeting) -> bool:
        """Do an arm's part of a meeting; return whether both arms can go on."""
        try:
            await job()
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
        except ArmStopped as error:
            arm.stopped = True
            meeting.fail(TransferOutcome.ARM_STOPPED, str(error))
        return meeting.outcome is not TransferOutcome.ARM_STOPPED

    def _gives(self, arm: PegArm, goal: Transfer) -> bool:
        """Return whether an arm gives: that on whose side the source is."""
        pegs = self.table.board.pegs_m
        leftwards = pegs[goal.target, 0] < pegs[goal.source, 0]
        return (arm is self.right) == bool(leftwards)

    # giving

    async def _give(self, script: OneArm, arm: PegArm, other: PegArm, meeting: Meeting) -> None:
        meeting.start_s = self.cell.clock.now_s()
        arm.hands_over = True
        grasp = await script.pick(meeting.goal.source)
        if not isinstance(grasp, Grasp):
            meeting.fail(grasp)
            await arm.let_go()
            return
        T_board_block = self.table.blocks.pop(meeting.goal.source)
        T_tip_block = arm.gripped(grasp, T_board_block)
        try:
            offered = await self._offer(arm, other, meeting, T_tip_block)
        except Blocked:  # the block stands where it stood: nothing has moved
            self.table.blocks[meeting.goal.source] = T_board_block
            await arm.let_go()
            raise
        if not offered:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not arm.holds:
            meeting.fail(TransferOutcome.DROPPED)
        else:
            meeting.offered.set()
            await self._await(arm, meeting.taken)
        if meeting.outcome is not None:
            await self._put_back(arm, T_tip_block, meeting.goal.source)
            return
        await self._part(arm, meeting)

    async def _part(self, arm: PegArm, meeting: Meeting) -> None:
        """Let go of a block that the other arm holds too, rise out of it, and go aside."""
        try:
            await arm.open(self.settings.release_rad)
            await self._rise(arm)
        except Blocked:
            self.cell.log.event("stayed", arm=arm.name, reason="there was no room to rise")
        finally:
            meeting.parted.set()
        try:
            await arm.shift((self._own_side(arm) * self.settings.aside_m, 0.0, 0.0), self.settings.meeting_margin_m)
        except Blocked:
            await arm.give_way()

    async def _offer(self, arm: PegArm, other: PegArm, meeting: Meeting, T_tip_block: SE3) -> bool:
        """Lift a block and bring it to where it is handed over."""

        def motion():
            offer = choose_offer(
                *self._partners(arm, other),
                self.table.T_world_board,
                arm.T_board_tip,
                T_tip_block,
                self.table.block,
                np.array(self.settings.meeting_m),
                self._ways(),
            )
            if isinstance(offer, str):
                self.cell.log.event("no place", reason=offer)
                return None
            lifted = raised(arm.T_board_tip, arm.height_m + self.settings.lift_m)
            points = [arm.hand.q, arm.ik(lifted), arm.ik(offer.T_board_tip)]
            return arm.through(points), offer

        planned = await arm.plan(motion)
        if planned is None:
            return False
        await arm.move(planned[0])
        await arm.hand.settle()
        meeting.T_board_block = planned[1].T_board_tip @ T_tip_block
        self.cell.log.event("offer", arm=arm.name, room_mm=round(1e3 * planned[1].room_m, 2))
        return True

    async def _rise(self, arm: PegArm) -> None:
        """Rise straight out of a block that the other arm holds."""
        await arm.shift((0.0, 0.0, self.settings.parts_m), self.settings.meeting_margin_m, meets_s=0.0)

    async def _put_back(self, arm: PegArm, T_tip_block: SE3, source: int) -> None:
        """Bring a block that nobody took back to where it was, if it is still there."""
        if arm.holds:
            placed = await arm.carry(T_tip_block, source)
            if placed is not None:
                self.table.blocks[source] = placed
        await arm.let_go()

    # receiving

    async def _receive(self, arm: PegArm, other: PegArm, meeting: Meeting) -> None:
        await self._wait_beside(arm)
        await self._await(arm, meeting.offered)
        if meeting.outcome is not None:
            return
        T_tip_block = await self._take(arm, other, meeting)
        if T_tip_block is None:
            meeting.fail(TransferOutcome.NOT_GRASPED)
            await self._leave(arm)
            return
        meeting.passed = True
        meeting.taken.set()
        await self._await(arm, meeting.parted)
        try:
            await self._place(arm, meeting, T_tip_block)
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
            await arm.let_go()

    async def _wait_beside(self, arm: PegArm) -> None:
        """Go to where the arm waits for a block, on its own side of where blocks are handed over and higher."""
        x, y, z = self.settings.meeting_m
        tip_m = z + self.table.block.height_m - self.settings.depth_m
        beside = [x + self._own_side(arm) * self.settings.aside_m, y, tip_m + self.settings.waits_above_m]
        pose = SE3.from_parts(SO3.axis("z", yaw_of(arm.T_board_tip) if arm.upright else np.pi), beside)
        try:
            await arm.go_over(pose)
        except Blocked:
            await arm.give_way()

    async def _await(self, arm: PegArm, event: trio.Event) -> None:
        """Wait for what the other arm does."""
        with self.cell.log.span(arm.name, "waiting"):
            await event.wait()

    def _own_side(self, arm: PegArm) -> float:
        """Return the sign of x in the board's frame on the side of an arm's base."""
        return float(np.sign(arm.T_base_board.inverse().translation_m[0]))

    async def _take(self, arm: PegArm, other: PegArm, meeting: Meeting) -> SE3 | None:
        """Take hold of the block in the other arm's jaws; return its pose in these, or None."""
        assert meeting.T_board_block is not None
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            T_board_block = await self._look(arm, meeting.T_board_block)
            if T_board_block is None:
                await arm.go_home()
                T_board_block = await self._look(arm, meeting.T_board_block)
            if T_board_block is None:
                return None
            grasp = await self._come(arm, other, T_board_block, failed)
            if grasp is None:
                return None
            T_tip_block = held_block(grasp.T_board_tip, T_board_block, self.table.block)
            if await arm.grip(T_tip_block):
                return T_tip_block
            self.cell.log.event("pick failed", arm=arm.name, attempt=attempt, jaw_rad=round(arm.hand.jaw_rad, 4))
            failed.append(grasp.candidate)
            await arm.open(self.settings.release_rad)
            await self._leave(arm)
        return None

    async def _look(self, arm: PegArm, T_board_expected: SE3) -> SE3 | None:
        """Look at a block in an arm's jaws; return its pose in the board's frame, upright, or None."""
        image = await self.table.capture(arm.hand)
        table = self.table
        fit = await arm.perceive(
            lambda: table.see.find_held_block(image, table.T_camera_board, table.block, T_board_expected)
        )
        if not fit.found:
            self.cell.log.event("no look", arm=arm.name, reason=fit.reason)
        return fit.T_board_block

    async def _come(self, arm: PegArm, other: PegArm, T_board_block: SE3, failed: list[int]) -> Grasp | None:
        """Come from above, the jaws open, down round a wall of the block that the other arm holds."""
        grasps: list[Grasp] = []

        def motion():
            grasp = choose_taking(
                *self._partners(other, arm),
                self.table.T_world_board,
                T_board_block,
                other.T_board_tip,
                self._ways(),
                avoid=tuple(failed),
            )
            if isinstance(grasp, str):
                self.cell.log.event("no grasp", arm=arm.name, reason=grasp)
                return None
            height = float(grasp.T_board_tip.translation_m[2]) + self.settings.waits_above_m
            points = arm.risen()
            points += [arm.ik(raised(grasp.T_board_tip, height)), arm.ik(grasp.T_board_tip)]
            grasps.append(grasp)
            return arm.path_through(points)

        for _ in range(1 + self.settings.detours):
            path = await arm.plan(motion)
            if path is None:
                return None
            try:
                await arm.move(
                    path.trajectory,
                    jaw_rad=self.settings.release_rad,
                    margin_m=self.settings.meeting_margin_m,
                    meets_s=float(path.waypoint_times_s[-2]),
                )
                break
            except Blocked:
                failed.append(grasps[-1].candidate)
        else:
            raise Blocked
        await arm.hand.settle()
        self.cell.log.event("taking", arm=arm.name, room_mm=round(1e3 * grasps[-1].clearance_m, 2))
        return grasps[-1]

    async def _leave(self, arm: PegArm) -> None:
        """Rise from a block that was not taken, and go home."""
        await self._rise(arm)
        await withdraw(arm)

    async def _place(self, arm: PegArm, meeting: Meeting, T_tip_block: SE3) -> None:
        """Look how the block lies in the jaws, bring it to its target and let go."""
        tip = arm.T_board_tip
        seen = await self._look(arm, tip @ T_tip_block)
        if seen is not None:
            off = seen.translation_m - (tip @ T_tip_block).translation_m
            self.cell.log.event("correction", arm=arm.name, off_mm=np.round(1e3 * off, 2).tolist())
            T_tip_block = tip.inverse() @ seen
        self.traffic.carries(arm.name, T_tip_block)
        place = await arm.carry(T_tip_block, meeting.goal.target)
        if place is None:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not arm.holds:
            meeting.fail(TransferOutcome.DROPPED)
        if meeting.outcome is not None:
            await arm.let_go()
            return
        await arm.open()
        if place is not None:
            self.table.blocks[meeting.goal.target] = place

    def _partners(self, giver: PegArm, receiver: PegArm) -> tuple[Partner, Partner]:
        """Return both arms; the giving one's jaws are closed on a block."""
        bases, open_rad = self.cell.T_world_base_registered, self.settings.release_rad
        arms = (giver, receiver)
        return tuple(Partner(arm.model, bases[arm.name], open_rad, giver.hand.jaw_rad) for arm in arms)  # type: ignore

    def _ways(self) -> Ways:
        return Ways(self.settings.waits_above_m, self.settings.parts_m, self.settings.depth_m)
