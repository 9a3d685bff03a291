"""What one arm can do with blocks: see, grasp, carry, place, let go, retreat. All agents' scripts are made of this."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import fk, ik
from trocar.cell import Result
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.motion import TimedPath, plan_through, rest_to_rest, straight
from trocar.perception.image import RgbdImage
from trocar.tasks.kit import ArmScript, Brief
from trocar.tasks.peg_transfer.agents.settings import GRASP_RULES, OUTER_RULES
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.agents.traffic import Blocked, Leaving, Traffic
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp, Jaws, choose_grasp
from trocar.tasks.peg_transfer.places import choose_place, held_block
from trocar.trajectory import Trajectory

JAW_SLACK_RAD = 0.03
"""Jaws that stay this close to their opening were kept from closing by something else than a wall."""

AT_HEIGHT_M = 1e-3

UPRIGHT = 0.999
AT_HOME = 1e-6


class ArmStopped(Exception):
    """An arm did not come to the end of its motion; it is not asked again."""


class PegArm:
    """One arm, the table that it shares, and the traffic that it keeps to.

    Attributes:
        hand: moves and computes.
        table: board and blocks.
        traffic: through it all motions go.
        home: (6,) where the arm is out of the camera's view.
        name: of the arm.
        hands_over: whether it grasps blocks so that another arm can take them.
        stopped: whether it did not come to the end of a motion, and is not asked again.
    """

    def __init__(self, brief: Brief, name: str, table: Table, traffic: Traffic):
        self.cell, self.settings, self.planner = brief.cell, brief.settings, brief.planner
        self.table, self.traffic = table, traffic
        self.hand = ArmScript(brief.cell, name, brief.settings.limits, brief.settings.settle_s)
        self.name, self.model, self.home = name, self.hand.model, self.hand.q
        self.hands_over = self.stopped = False

    @property
    def T_base_board(self) -> SE3:
        """Return the pose of the board in the arm's base."""
        return self.cell.T_world_base_registered[self.name].inverse() @ self.table.T_world_board

    @property
    def T_board_tip(self) -> SE3:
        """Return the pose of the tip as the joints tell."""
        return self.T_base_board.inverse() @ fk(self.model, self.hand.q)

    @property
    def height_m(self) -> float:
        """Return the height of the tip over the plate."""
        return float(self.T_board_tip.translation_m[2])

    @property
    def upright(self) -> bool:
        """Return whether the tool is vertical."""
        return float(self.T_board_tip.matrix[2, 2]) > UPRIGHT

    @property
    def holds(self) -> bool:
        """Return whether the jaws' motor stalled on something as thick as a block's wall."""
        return self.settings.jaw_empty_rad < self.hand.jaw_rad < self.settings.release_rad - JAW_SLACK_RAD

    async def wake(self) -> None:
        """Turn the wrist to and fro, see ``ArmScript.wake``."""
        await self.hand.wake()

    async def see(self, source: int, failed: Sequence[int] = ()) -> Grasp | TransferOutcome:
        """Look at a peg; return how to grasp its block, other than what has failed, or why not."""
        image = await self.table.capture(self.hand)
        seen = await self.perceive(lambda: self._plan_grasp(image, source, failed))
        if isinstance(seen, Grasp):
            return seen
        reason, outcome = seen
        self.cell.log.event("no grasp", peg=source, reason=reason)
        return outcome

    def _plan_grasp(self, image: RgbdImage, source: int, failed: Sequence[int]) -> Grasp | tuple[str, TransferOutcome]:
        table = self.table
        fit = table.see.find_block(image, table.T_camera_board, table.board, table.block, source)
        if not fit.found or fit.T_board_block is None:
            table.blocks.pop(source, None)
            return fit.reason, TransferOutcome.NO_BLOCK
        table.blocks[source] = fit.T_board_block
        others = [pose.matrix for peg, pose in table.blocks.items() if peg != source]
        neighbours = SE3(np.array(others)) if others else None
        refusal = ""
        own_side = self.T_base_board.inverse().translation_m[:2]
        for outer, min_gap_m, max_roll_rad in OUTER_RULES if self.hands_over else GRASP_RULES:
            grasp = choose_grasp(
                self.model,
                self.T_base_board,
                fit.T_board_block,
                table.board,
                table.block,
                neighbours,
                avoid=failed,
                depth_m=self.settings.depth_m,
                jaws=replace(Jaws.of(self.model.instrument), min_gap_m=min_gap_m),
                max_roll_rad=max_roll_rad,
                towards=own_side if outer else None,
            )
            if isinstance(grasp, Grasp):
                return grasp
            refusal = grasp.reason
        return refusal, TransferOutcome.OUT_OF_REACH

    async def go_to(self, grasp: Grasp, source: int) -> bool:
        """Travel over the pegs, then down round the wall of a block, the jaws open; False if no motion does it."""
        opening = float(np.clip(grasp.jaw_rad, self.settings.release_rad, self.settings.jaw_open_rad))
        for margin_m in self.margins_m():
            planned = await self.plan(lambda: (self._approach(grasp.T_board_tip), self._leaving(grasp, source)))
            if planned is None:
                return False
            motion, leaving = planned
            try:
                await self.move(motion, jaw_rad=opening, margin_m=margin_m, leaving=leaving)
            except Blocked:
                await self.give_way()
                continue
            await self.hand.settle()
            return True
        raise Blocked

    def _approach(self, T_board_tip: SE3) -> Trajectory:
        above = raised(T_board_tip, self.settings.clear_height_m)
        return self.through([*self.risen(), self.ik(above), self.ik(T_board_tip)])

    def risen(self) -> list[NDArray[np.float64]]:
        """Return the first waypoints of any motion: where the arm is, and over the pegs if it is lower."""
        if self.height_m >= self.settings.clear_height_m - AT_HEIGHT_M:
            return [self.hand.q]
        return [self.hand.q, self.ik(raised(self.T_board_tip, self.settings.clear_height_m))]

    async def go_over(self, T_board_tip: SE3) -> None:
        """Travel to a pose over the pegs."""
        if np.linalg.norm(T_board_tip.translation_m - self.T_board_tip.translation_m) < AT_HEIGHT_M:
            return
        motion = await self.plan(lambda: self.through([*self.risen(), self.ik(T_board_tip)]))
        if motion is not None:
            await self.move(motion)

    async def grip(self, T_tip_block: SE3 | None = None) -> bool:
        """Close the jaws; return whether they hold something: a block, where one is expected."""
        await self.hand.jaw(self.settings.jaw_closed_rad)
        self.traffic.carries(self.name, T_tip_block if self.holds else None)
        return self.holds

    async def open(self, jaw_rad: float | None = None) -> None:
        """Open the jaws; None: as wide as usual."""
        await self.hand.jaw(self.settings.jaw_open_rad if jaw_rad is None else jaw_rad)
        self.traffic.carries(self.name, None)

    async def carry(self, T_tip_block: SE3, target: int) -> SE3 | None:
        """Lift, travel, lower; return where the block should lie now, or None where no pose is in reach."""
        for margin_m in self.margins_m():
            planned = await self.plan(lambda: self._transfer_motion(T_tip_block, target))
            if planned is None:
                return None
            motion, T_board_placed = planned
            try:
                await self.move(motion, margin_m=margin_m)
            except Blocked:
                await self.give_way()
                continue
            await self.hand.settle()
            return T_board_placed
        raise Blocked

    def _transfer_motion(self, T_tip_block: SE3, target: int) -> tuple[Trajectory, SE3] | None:
        tip = self.T_board_tip
        place = choose_place(
            self.model,
            self.T_base_board,
            T_tip_block,
            self.table.board,
            self.table.block,
            target,
            list(self.table.blocks.values()),
            self.settings.drop_m,
            yaw_rad=yaw_of(tip),
        )
        if isinstance(place, str):
            self.cell.log.event("no place", peg=target, reason=place)
            return None
        height = place.T_board_tip.translation_m[2] - self.settings.drop_m + self.settings.lift_m
        points = [self.hand.q]
        if self.height_m < height - AT_HEIGHT_M:
            points.append(self.ik(raised(tip, height)))
        points += [self.ik(raised(place.T_board_tip, height)), self.ik(place.T_board_tip)]
        return self.through(points), place.T_board_tip @ T_tip_block

    async def let_go(self) -> None:
        """Open the jaws and rise above the pegs."""
        await self.open()
        await self.retreat()

    async def retreat(self) -> None:
        """Rise above the pegs."""
        if self.height_m < self.settings.clear_height_m - AT_HEIGHT_M:
            above = raised(self.T_board_tip, self.settings.clear_height_m)
            motion = await self.plan(lambda: self.through([self.hand.q, self.ik(above)]))
            if motion is not None:
                await self.move(motion)

    async def shift(self, line_m: Sequence[float], margin_m: float, meets_s: float = inf) -> None:
        """Move the tip straight, in the board's axes."""
        line = self.T_base_board.rotation.apply(np.array(line_m))
        motion = await self.plan(lambda: self._prepared(straight(self.model, self.hand.q, line, self.settings.limits)))
        if motion is not None:
            await self.move(motion, margin_m=margin_m, meets_s=meets_s)

    def _prepared(self, motion: Trajectory) -> Trajectory:
        """Return a motion, its commands found already."""
        self.cell.robot.prepare({self.name: motion})
        return motion

    async def go_home(self) -> None:
        """Rise and leave the camera's view of the board."""
        await self.retreat()
        if np.abs(self.hand.q - self.home).max() < AT_HOME:
            return
        motion = await self.plan(lambda: self._prepared(rest_to_rest(self.hand.q, self.home, self.settings.limits)))
        if motion is not None:
            await self.move(motion)

    def _leaving(self, grasp: Grasp, source: int) -> Leaving | None:
        """Return how the arm lifts the block that it is about to grasp."""
        block = self.table.blocks.get(source)
        if block is None:
            return None
        lifted = raised(grasp.T_board_tip, float(grasp.T_board_tip.translation_m[2]) + self.settings.lift_m)
        motion = rest_to_rest(self.ik(grasp.T_board_tip), self.ik(lifted), self.settings.limits)
        return Leaving(motion, self.gripped(grasp, block))

    def margins_m(self) -> list[float]:
        """Return the margins to the other arm that are tried in turn."""
        return [self.settings.margin_m] + [self.settings.min_margin_m] * self.settings.detours

    async def give_way(self) -> None:
        """Leave room for the other arm: go home, or wait where that cannot be or with a block in the jaws."""
        self.cell.log.event("gives way", arm=self.name)
        try:
            if not self.traffic.holds(self.name):
                await self.go_home()
                return
        except Blocked:
            pass
        await self.cell.clock.sleep(self.settings.pause_s)

    async def move(
        self,
        motion: Trajectory,
        *,
        jaw_rad: float | None = None,
        margin_m: float | None = None,
        meets_s: float = inf,
        leaving: Leaving | None = None,
    ) -> None:
        """Run a motion as soon as the other arm leaves room for it, and meanwhile drive the jaws.

        Args:
            motion: from where the arm rests.
            jaw_rad: opening of the jaws; None: as they are.
            margin_m: to keep to the other arm; None: as usual.
            meets_s: from this time of the motion on, the jaws may meet the block in the other arm's jaws.
            leaving: how the arm gets away from where the motion ends.

        Raises:
            Blocked: the other arm is in the way, and waiting does not help.
            ArmStopped: the arm did not come to the end.
        """
        await self.traffic.admit(self.hand, motion, jaw_rad, margin_m, meets_s, leaving)
        if jaw_rad is None:
            execution = await self.traffic.run(self.hand, motion)
        else:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self.cell.robot.jaw, self.name, jaw_rad)
                execution = await self.traffic.run(self.hand, motion)
        if not execution.done:
            raise ArmStopped(execution.reason)

    def ik(self, T_board_tip: SE3) -> NDArray[np.float64]:
        """Return the joints (6,) that hold the tip there."""
        return ik(self.model, self.T_base_board @ T_board_tip)

    def through(self, points: Sequence[NDArray[np.float64]]) -> Trajectory:
        """Return a motion through these joints, its commands found already."""
        return self.path_through(points).trajectory

    def path_through(self, points: Sequence[NDArray[np.float64]]) -> TimedPath:
        """Return such a motion, and when it passes the joints."""
        up = self.T_base_board.matrix[:3, 2]
        plan = plan_through(self.model, np.array(points), self.settings.limits, up=up, planner=self.planner)
        return TimedPath(self._prepared(plan.trajectory), next(iter(plan.waypoint_times_s.values())))

    async def plan(self, compute: Callable[[], Result]) -> Result | None:
        """Plan a motion; None, with the reason in the log, where a pose or the way to it leaves the joints' ranges."""

        def attempt() -> Result | None:
            try:
                return compute()
            except TrocarError as error:
                self.cell.log.event("no motion", arm=self.name, reason=str(error))
                return None

        return await self.hand.compute("planning", self.settings.planning_budget_s, attempt)

    async def perceive(self, compute: Callable[[], Result]) -> Result:
        """Compute on an image."""
        return await self.hand.compute("perception", self.settings.perception_budget_s, compute)

    def gripped(self, grasp: Grasp, T_board_block: SE3) -> SE3:
        """Return the pose of a block in the jaws that have closed on it."""
        return held_block(grasp.T_board_tip, T_board_block, self.table.block)


def raised(T_board_tip: SE3, height_m: float) -> SE3:
    """Return a pose of the tip at another height over the plate."""
    x, y, _ = T_board_tip.translation_m
    return SE3.from_parts(T_board_tip.rotation, [x, y, height_m])


def yaw_of(T_board_tip: SE3) -> float:
    """Return the yaw of a vertical tool about the board's z."""
    return float(np.arctan2(T_board_tip.matrix[1, 0], T_board_tip.matrix[0, 0]))
