"""The arm that takes a block from the other and places it."""

from __future__ import annotations

import numpy as np

from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.agents.meeting import choose_taking
from trocar.tasks.peg_transfer.agents.peg_arm import raised, yaw_of
from trocar.tasks.peg_transfer.agents.side import Appointment, Side
from trocar.tasks.peg_transfer.agents.traffic import Blocked
from trocar.tasks.peg_transfer.agents.two_arms import withdraw
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp
from trocar.tasks.peg_transfer.places import held_block


class Receiver(Side):
    """Waits beside, looks, takes, looks again, places."""

    async def receive(self, meeting: Appointment) -> None:
        """Do this arm's part of a handover."""
        await self._wait_beside()
        await self.wait_for(meeting.offered)
        if meeting.outcome is not None:
            return
        T_tip_block = await self._take(meeting)
        if T_tip_block is None:
            meeting.fail(TransferOutcome.NOT_GRASPED)
            await self._leave()
            return
        meeting.passed = True
        meeting.taken.set()
        await self.wait_for(meeting.parted)
        try:
            await self._place(meeting, T_tip_block)
        except Blocked:
            meeting.fail(TransferOutcome.BLOCKED)
            await self.arm.let_go()

    async def _wait_beside(self) -> None:
        """Go to where the arm waits for a block, on its own side of where blocks are handed over and higher."""
        x, y, z = self.settings.meeting_m
        tip_m = z + self.table.block.height_m - self.settings.depth_m
        beside = [x + self.own_side * self.settings.aside_m, y, tip_m + self.settings.waits_above_m]
        pose = SE3.from_parts(SO3.axis("z", yaw_of(self.arm.T_board_tip) if self.arm.upright else np.pi), beside)
        try:
            await self.arm.go_over(pose)
        except Blocked:
            await self.arm.give_way()

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

        def motion():
            grasp = choose_taking(
                *self.partners(self.other, self.arm),
                self.table.T_world_board,
                T_board_block,
                self.other.T_board_tip,
                self.ways(),
                avoid=tuple(failed),
            )
            if isinstance(grasp, str):
                self.cell.log.event("no grasp", arm=self.arm.name, reason=grasp)
                return None
            height = float(grasp.T_board_tip.translation_m[2]) + self.settings.waits_above_m
            points = self.arm.risen()
            points += [self.arm.ik(raised(grasp.T_board_tip, height)), self.arm.ik(grasp.T_board_tip)]
            grasps.append(grasp)
            return self.arm.path_through(points)

        for _ in range(1 + self.settings.detours):
            path = await self.arm.plan(motion)
            if path is None:
                return None
            try:
                await self.arm.move(
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
        await self.arm.hand.settle()
        self.cell.log.event("taking", arm=self.arm.name, room_mm=round(1e3 * grasps[-1].clearance_m, 2))
        return grasps[-1]

    async def _leave(self) -> None:
        """Rise from a block that was not taken, and go home."""
        await self.rise()
        await withdraw(self.arm)

    async def _place(self, meeting: Appointment, T_tip_block: SE3) -> None:
        """Look how the block lies in the jaws, bring it to its target and let go."""
        tip = self.arm.T_board_tip
        seen = await self._look(tip @ T_tip_block)
        if seen is not None:
            off = seen.translation_m - (tip @ T_tip_block).translation_m
            self.cell.log.event("correction", arm=self.arm.name, off_mm=np.round(1e3 * off, 2).tolist())
            T_tip_block = tip.inverse() @ seen
        self.arm.traffic.carries(self.arm.name, T_tip_block)
        place = await self.arm.carry(T_tip_block, meeting.goal.target)
        if place is None:
            meeting.fail(TransferOutcome.OUT_OF_REACH)
        elif not self.arm.holds:
            meeting.fail(TransferOutcome.DROPPED)
        if meeting.outcome is not None:
            await self.arm.let_go()
            return
        await self.arm.open()
        if place is not None:
            self.table.blocks[meeting.goal.target] = place
