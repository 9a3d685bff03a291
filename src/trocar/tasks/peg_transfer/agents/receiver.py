"""The arm that takes a block from the other and places it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np
import trio

from trocar.geometry import SE3, SO3
from trocar.motion import TimedPath
from trocar.tasks.peg_transfer.agents.meeting import choose_taking
from trocar.tasks.peg_transfer.agents.motions import Carriage, Joints, end_of, raised, starts_at, yaw_of
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.side import Appointment, Side
from trocar.tasks.peg_transfer.agents.together import Pending, with_helpers
from trocar.tasks.peg_transfer.agents.traffic import Blocked
from trocar.tasks.peg_transfer.agents.transfers import OneArm
from trocar.tasks.peg_transfer.agents.two_arms import withdraw
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp
from trocar.tasks.peg_transfer.places import held_block


@dataclass(frozen=True, eq=False)
class Coming:
    """A motion to over where a block will be taken.

    Attributes:
        path: over the pegs.
        grasp: with which it is to be taken.
    """

    path: TimedPath
    grasp: Grasp


class Receiver(Side):
    """Waits above, looks, takes, looks again, places."""

    def __init__(self, arm: PegArm, other: PegArm, script: OneArm):
        super().__init__(arm, other, script)
        self._ready: Pending[Coming] = Pending()

    async def receive(self, meeting: Appointment, to_give: Appointment | None, to_receive: Appointment | None) -> None:
        """Do this arm's part of a handover.

        Args:
            meeting: this one.
            to_give: the next one, if this arm gives there.
            to_receive: the next one, if it receives there too.
        """
        await self._come_near(meeting)
        await self._wait_until_offered(meeting)
        if meeting.outcome is not None:
            return
        T_tip_block = await self._take(meeting)
        if T_tip_block is None:
            meeting.fail(TransferOutcome.NOT_GRASPED)
            await self._leave()
            return
        meeting.passed = True
        meeting.taken.set()
        await self.wait_for(meeting.released)
        try:
            await with_helpers(partial(self._place, meeting, T_tip_block, to_give, to_receive))
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
            await self.arm.let_go()

    async def _come_near(self, meeting: Appointment) -> None:
        """Wait beside until it is known where the block will be offered, then over where it will be grasped."""
        try:
            if not meeting.announced.is_set():
                await self._wait_beside()
                await self.wait_for(meeting.announced)
            if meeting.outcome is None:
                await self._wait_above(meeting)
        except Blocked:
            await self.arm.give_way()

    async def _wait_until_offered(self, meeting: Appointment) -> None:
        """Wait for the block; leave room for the arm that brings it, if it asks for that."""
        await self.wait_for(meeting.crowded, meeting.offered)
        if not meeting.offered.is_set():
            try:
                await self._wait_beside()
            except Blocked:
                await self.arm.give_way()
            await self.wait_for(meeting.offered)

    async def _wait_beside(self) -> None:
        """Go to this arm's side of where blocks are handed over, and higher."""
        x, y, z = self.settings.meeting_m
        tip_m = z + self.table.block.height_m - self.settings.depth_m
        beside = [x + self.own_side * self.settings.aside_m, y, tip_m + self.settings.waits_above_m]
        pose = SE3.from_parts(SO3.axis("z", yaw_of(self.arm.T_board_tip) if self.arm.upright else np.pi), beside)
        await self.arm.go_over(pose)

    async def _wait_above(self, meeting: Appointment) -> None:
        """Go over the grasp that is expected: by what the giving arm said, before anybody has looked."""
        avoid: list[int] = []
        ready = await self._ready.take()
        for _ in range(1 + self.settings.detours):
            if ready is None or not starts_at(ready.path, self.arm.hand.q):
                ready = await self.arm.plan(lambda: self._find_coming(self.arm.hand.q, meeting, avoid))
            if ready is None:
                return
            try:
                await self.arm.move(
                    ready.path.trajectory,
                    jaw_rad=self.settings.release_rad,
                    margin_m=self.settings.meeting_margin_m,
                    waits=False,
                )
                return
            except Blocked:
                avoid.append(ready.grasp.candidate)
                ready = None
        self.cell.log.event("waits beside", arm=self.arm.name)

    def _find_coming(self, q: Joints, meeting: Appointment, avoid: list[int]) -> Coming | None:
        assert meeting.T_board_block is not None and meeting.T_board_giver is not None
        grasp = self._grasp(meeting.T_board_block, meeting.T_board_giver, avoid)
        return None if grasp is None else Coming(self.arm.motions.over(q, self._above(grasp)), grasp)

    def _above(self, grasp: Grasp) -> SE3:
        tip = grasp.T_board_tip
        return raised(tip, float(tip.translation_m[2]) + self.settings.waits_above_m)

    def _grasp(
        self, T_board_block: SE3, T_board_giver: SE3, failed: list[int], near: SE3 | None = None
    ) -> Grasp | None:
        """Return how to grasp a block in the other arm's jaws; near a pose of the tip, if one is given."""
        grasp = choose_taking(
            *self.partners(self.other, self.arm),
            self.table.T_world_board,
            T_board_block,
            T_board_giver,
            self.ways(),
            avoid=tuple(failed),
            near=near,
        )
        if isinstance(grasp, str):
            if near is not None:
                return None
            self.cell.log.event("no grasp", arm=self.arm.name, reason=grasp)
            return None
        return grasp

    async def _take(self, meeting: Appointment) -> SE3 | None:
        """Take hold of the block in the other arm's jaws; return its pose in these, or None."""
        assert meeting.T_board_block is not None
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            T_board_block = await self._look(meeting.T_board_block)
            if T_board_block is None:
                await self.arm.go_home()
                T_board_block = await self._look(meeting.T_board_block)
            if T_board_block is None:
                return None
            grasp = await self._come(T_board_block, failed)
            if grasp is None:
                return None
            T_tip_block = held_block(grasp.T_board_tip, T_board_block, self.table.block)
            if await self.arm.grip(T_tip_block):
                return T_tip_block
            self.cell.log.event(
                "pick failed", arm=self.arm.name, attempt=attempt, jaw_rad=round(self.arm.hand.jaw_rad, 4)
            )
            failed.append(grasp.candidate)
            await self.arm.open(self.settings.release_rad)
            await self._leave()
        return None

    async def _look(self, T_board_expected: SE3) -> SE3 | None:
        """Look at a block in an arm's jaws; return its pose in the board's frame, upright, or None."""
        image = await self.table.capture(self.arm.hand)
        table = self.table
        fit = await self.arm.perceive(
            lambda: table.see.find_held_block(image, table.T_camera_board, table.block, T_board_expected)
        )
        if not fit.found:
            self.cell.log.event("no look", arm=self.arm.name, reason=fit.reason)
        return fit.T_board_block

    async def _come(self, T_board_block: SE3, failed: list[int]) -> Grasp | None:
        """Come from above, the jaws open, down round a wall of the block that the other arm holds."""
        grasps: list[Grasp] = []
        motions = self.arm.motions

        def motion() -> tuple[TimedPath, float] | None:
            q, other = self.arm.hand.q, self.other.T_board_tip
            grasp = self._grasp(T_board_block, other, failed, near=self.arm.T_board_tip)
            if grasp is not None:  # the arm is over it
                grasps.append(grasp)
                return motions.through([q, motions.ik(grasp.T_board_tip)]), 0.0
            grasp = self._grasp(T_board_block, other, failed)
            if grasp is None:
                return None
            grasps.append(grasp)
            points = [*motions.risen(q), motions.ik(self._above(grasp)), motions.ik(grasp.T_board_tip)]
            path = motions.through(points)
            return path, float(path.waypoint_times_s[-2])

        for attempt in range(1 + self.settings.detours):
            planned = await self.arm.plan(motion)
            if planned is None:
                return None
            try:
                await self.arm.move(
                    planned[0].trajectory,
                    jaw_rad=self.settings.release_rad,
                    margin_m=self.settings.meeting_margin_m,
                    meets_s=(planned[1], inf),
                    waits=attempt == self.settings.detours,
                )
                break
            except Blocked:
                failed.append(grasps[-1].candidate)
        else:
            raise Blocked
        await self.arm.hand.settle()
        self.cell.log.event("taking", arm=self.arm.name, room_mm=round(1e3 * grasps[-1].clearance_m, 2))
        return grasps[-1]

    async def _leave(self) -> None:
        """Rise from a block that was not taken, and go home."""
        await self.rise()
        await withdraw(self.arm)

    async def _place(
        self,
        meeting: Appointment,
        T_tip_block: SE3,
        to_give: Appointment | None,
        to_receive: Appointment | None,
        helpers: trio.Nursery,
    ) -> None:
        """Look how the block lies in the jaws while the other arm goes, bring it to its target and let go."""
        tip, target = self.arm.T_board_tip, meeting.goal.target
        seen = await self._look(tip @ T_tip_block)
        if seen is not None:
            off = seen.translation_m - (tip @ T_tip_block).translation_m
            self.cell.log.event("correction", arm=self.arm.name, off_mm=np.round(1e3 * off, 2).tolist())
            T_tip_block = tip.inverse() @ seen
        ready = await self.arm.plan(lambda: self.arm.motions.carriage(self.arm.hand.q, T_tip_block, None, target))
        await self.wait_for(meeting.parted)
        self.arm.traffic.carries(self.arm.name, T_tip_block)

        def begun(carriage: Carriage) -> None:
            self.table.blocks[target] = carriage.T_board_placed
            if self.settings.looks_ahead and to_give is not None:
                self.script.seen.start(helpers, partial(self.script.look_ahead, carriage.path, to_give.goal.source))
            if self.settings.looks_ahead and to_receive is not None:
                self._ready.start(helpers, partial(self._plan_ahead, carriage.path, to_receive))

        place = await self.arm.carry(T_tip_block, target, ready, begun)
        if place is None:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not self.arm.holds:
            del self.table.blocks[target]
            meeting.fail(TransferOutcome.DROPPED)
        if meeting.outcome is not None:
            await self.arm.let_go()
            return
        await self.arm.open()

    async def _plan_ahead(self, path: TimedPath, meeting: Appointment) -> Coming | None:
        """Plan, while the arm goes down to its target, how to come to the next block, if it is known by then."""
        with trio.move_on_after(path.trajectory.duration_s):
            await meeting.announced.wait()
        if meeting.T_board_block is None:
            return None
        return await self.arm.plan(lambda: self._find_coming(end_of(path), meeting, []))
