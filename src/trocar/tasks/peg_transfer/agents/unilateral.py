"""One arm transfers all blocks: see, grasp, carry, place, check (paper, section IV)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import MOTION_LIMITS, MotionLimits, fk, ik
from trocar.cell import Camera, Cell, Result
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.motion import plan_through
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.tasks.kit import ArmScript, Brief
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp, Jaws, choose_grasp
from trocar.tasks.peg_transfer.places import choose_place, held_block
from trocar.trajectory import Trajectory

JAW_SLACK_RAD = 0.03
"""Jaws that stay this close to their opening were kept from closing by something else than a wall."""

GRASP_RULES = ((0.15e-3, np.radians(70.0)), (0.15e-3, np.radians(110.0)), (-0.6e-3, np.radians(110.0)))
"""Least gap (m) round the open fingers and largest roll, tried in turn; below zero a finger must slide off the round
end of the peg or push the block aside."""


@dataclass(frozen=True)
class Settings:
    """How the agent works; lengths in m, angles in rad, times on the cell's clock in s.

    Attributes:
        perception_budget_s: declared for registration and grasp planning (paper: .098 s).
        survey_budget_s: declared for registering the board, and for the last look at all blocks.
        planning_budget_s: declared for planning a motion (paper: .103 s).
        settle_s: rest after a motion before the jaws act.
        jaw_open_rad: opening round the wall of a block, against the clearance in its hole.
        depth_m: of the tip under the block's top face.
        jaw_closed_rad: target that lets the drive press.
        jaw_empty_rad: jaws that close further than this hold nothing.
        clear_height_m: of the tip over the plate when it travels empty; the pegs are 20 mm tall.
        lift_m: how far a held block is raised: its lower face clears the pegs.
        drop_m: height of a block's lower face over the plate when it is released.
        retries: how often a failed pick is tried again.
        limits: of velocity and acceleration.
    """

    perception_budget_s: float = 0.098
    survey_budget_s: float = 0.25
    planning_budget_s: float = 0.103
    settle_s: float = 0.06
    jaw_open_rad: float = 0.40
    depth_m: float = 4.0e-3
    jaw_closed_rad: float = -0.17
    jaw_empty_rad: float = 0.08
    clear_height_m: float = 27e-3
    lift_m: float = 26e-3
    drop_m: float = 2e-3
    retries: int = 1
    limits: MotionLimits = field(default_factory=lambda: MOTION_LIMITS["paper"])


class Unilateral:
    """One arm, one block after the other."""

    def __init__(self, brief: Brief):
        cell, settings = brief.cell, brief.settings
        self.cell, self.settings, self.goals, self.see = cell, settings, brief.goals, brief.perception
        self.planner = brief.planner
        self.hand = ArmScript(cell, brief.arms[0], settings.limits, settings.settle_s)
        self.board, self.block = brief.known.board, brief.known.block
        self.arm, self.name = self.hand.model, self.hand.name
        self.camera, self.T_world_camera = _rgbd(cell)
        self._place_board(cell.T_world_fixture["board"])
        self.home = self.hand.q
        self.blocks: dict[int, SE3] = {}
        """Poses of the blocks in the board's frame, as last seen or placed, by peg."""

    async def run(self) -> None:
        """Do the transfers one after the other, and look once more at the end."""
        await self.hand.wake()
        if not await self._find_board():
            return
        for goal in self.goals:
            start_s = self.cell.clock.now_s()
            outcome = await self._transfer(*goal)
            self.cell.log.event(
                "transfer", source=goal.source, target=goal.target, start_s=round(start_s, 6), outcome=outcome.name
            )
            if outcome not in (TransferOutcome.DONE, TransferOutcome.NO_BLOCK):
                await self._let_go()
        await self._go_home()
        await self._check()

    async def _transfer(self, source: int, target: int) -> TransferOutcome:
        """Move one block; every way in which this can end is an outcome."""
        failed: list[int] = []
        for attempt in range(1 + self.settings.retries):
            grasp = await self._see(source, failed)
            if not isinstance(grasp, Grasp):
                await self._go_home()
                grasp = await self._see(source, failed)
            if not isinstance(grasp, Grasp):
                return grasp
            if not await self._go_to(grasp):
                return TransferOutcome.OUT_OF_REACH
            await self.hand.jaw(self.settings.jaw_closed_rad)
            if self._holds():
                break
            self.cell.log.event("pick failed", peg=source, attempt=attempt, jaw_rad=round(self.hand.jaw_rad, 4))
            failed.append(grasp.candidate)
            await self._let_go()
        else:
            return TransferOutcome.NOT_GRASPED
        place = await self._carry(grasp, self.blocks.pop(source), target)
        if place is None:
            return TransferOutcome.OUT_OF_REACH
        if not self._holds():
            return TransferOutcome.DROPPED
        await self.hand.jaw(self.settings.jaw_open_rad)
        self.blocks[target] = place
        return TransferOutcome.DONE

    async def _find_board(self) -> bool:
        """Register the board once; it does not move during a trial. Return whether it was there."""
        image = await self._capture()
        guess = self.cell.T_world_fixture["board"]
        fit = await self._survey(lambda: self.see.find_board(image, self.T_world_camera, self.board, guess))
        if not fit.found:
            self.cell.log.event("stopped", outcome=TransferOutcome.BOARD_NOT_FOUND.name, reason=fit.reason)
            return False
        self._place_board(fit.T_world_board)
        return True

    def _place_board(self, T_world_board: SE3) -> None:
        self.T_camera_board = self.T_world_camera.inverse() @ T_world_board
        self.T_base_board = self.cell.T_world_base_registered[self.name].inverse() @ T_world_board

    async def _check(self) -> None:
        """Look from home whether the blocks lie where they were set down; those picked again were checked then."""
        image = await self._capture()
        pegs = sorted(self.blocks)
        fits = await self._survey(
            lambda: [self.see.find_block(image, self.T_camera_board, self.board, self.block, peg) for peg in pegs]
        )
        seen = [peg for peg, fit in zip(pegs, fits, strict=True) if fit.found]
        self.cell.log.event("check", pegs=seen, missing=sorted(set(pegs) - set(seen)))

    async def _see(self, source: int, failed: Sequence[int]) -> Grasp | TransferOutcome:
        """Look at the source peg; return how to grasp its block, other than what has failed, or why not."""
        image = await self._capture()
        seen = await self._perceive(lambda: self._plan_grasp(image, source, failed))
        if isinstance(seen, Grasp):
            return seen
        reason, outcome = seen
        self.cell.log.event("no grasp", peg=source, reason=reason)
        return outcome

    def _plan_grasp(self, image: RgbdImage, source: int, failed: Sequence[int]) -> Grasp | tuple[str, TransferOutcome]:
        fit = self.see.find_block(image, self.T_camera_board, self.board, self.block, source)
        if not fit.found or fit.T_board_block is None:
            self.blocks.pop(source, None)
            return fit.reason, TransferOutcome.NO_BLOCK
        self.blocks[source] = fit.T_board_block
        others = [pose.matrix for peg, pose in self.blocks.items() if peg != source]
        neighbours = SE3(np.array(others)) if others else None
        refusal = ""
        for min_gap_m, max_roll_rad in GRASP_RULES:
            grasp = choose_grasp(
                self.arm,
                self.T_base_board,
                fit.T_board_block,
                self.board,
                self.block,
                neighbours,
                avoid=failed,
                depth_m=self.settings.depth_m,
                jaws=replace(Jaws.of(self.arm.instrument), min_gap_m=min_gap_m),
                max_roll_rad=max_roll_rad,
            )
            if isinstance(grasp, Grasp):
                return grasp
            refusal = grasp.reason
        return refusal, TransferOutcome.OUT_OF_REACH

    async def _go_to(self, grasp: Grasp) -> bool:
        """Travel over the pegs, then down round the wall of the block, the jaws open; False if no motion does it."""
        motion = await self._plan(lambda: self._approach(grasp))
        if motion is None:
            return False
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self.cell.robot.jaw, self.name, self.settings.jaw_open_rad)
            nursery.start_soon(self.hand.move, motion)
        await self.hand.settle()
        return True

    def _approach(self, grasp: Grasp) -> Trajectory:
        above = self._raised(grasp.T_board_tip, self.settings.clear_height_m)
        points = [self.hand.q]
        if self._height() < self.settings.clear_height_m - 1e-3:
            points.append(self._ik(self._raised(self._tip(), self.settings.clear_height_m)))
        points.append(self._ik(above))
        points.append(self._ik(grasp.T_board_tip))
        return self._through(points)

    async def _carry(self, grasp: Grasp, T_board_block: SE3, target: int) -> SE3 | None:
        """Lift, travel, lower; return where the block should lie now, or None where no pose is in reach."""
        T_tip_block = held_block(grasp.T_board_tip, T_board_block, self.block)
        planned = await self._plan(lambda: self._transfer_motion(T_tip_block, target))
        if planned is None:
            return None
        motion, T_board_placed = planned
        await self.hand.move(motion)
        await self.hand.settle()
        return T_board_placed

    def _transfer_motion(self, T_tip_block: SE3, target: int) -> tuple[Trajectory, SE3] | None:
        others = list(self.blocks.values())
        tip = self._tip()
        place = choose_place(
            self.arm,
            self.T_base_board,
            T_tip_block,
            self.board,
            self.block,
            target,
            others,
            self.settings.drop_m,
            yaw_rad=float(np.arctan2(tip.matrix[1, 0], tip.matrix[0, 0])),
        )
        if isinstance(place, str):
            self.cell.log.event("no place", peg=target, reason=place)
            return None
        start = self.hand.q
        height = float(tip.translation_m[2]) + self.settings.lift_m
        lifted = self._ik(self._raised(tip, height))
        over = self._ik(self._raised(place.T_board_tip, height))
        down = self._ik(place.T_board_tip)
        return self._through([start, lifted, over, down]), place.T_board_tip @ T_tip_block

    async def _let_go(self) -> None:
        """Open the jaws and rise above the pegs."""
        await self.hand.jaw(self.settings.jaw_open_rad)
        await self._retreat()

    async def _retreat(self) -> None:
        if self._height() < self.settings.clear_height_m - 1e-3:
            above = self._raised(self._tip(), self.settings.clear_height_m)
            motion = await self._plan(lambda: self._through([self.hand.q, self._ik(above)]))
            if motion is not None:
                await self.hand.move(motion)

    async def _go_home(self) -> None:
        """Rise and leave the camera's view of the board."""
        await self._retreat()
        await self.hand.go(self.home)

    def _holds(self) -> bool:
        """Return whether the jaws' motor stalled on something as thick as a block's wall."""
        return self.settings.jaw_empty_rad < self.hand.jaw_rad < self.settings.jaw_open_rad - JAW_SLACK_RAD

    def _tip(self) -> SE3:
        """Return ``T_board_tip`` as the joints tell."""
        return self.T_base_board.inverse() @ fk(self.arm, self.hand.q)

    def _height(self) -> float:
        return float(self._tip().translation_m[2])

    @staticmethod
    def _raised(T_board_tip: SE3, height_m: float) -> SE3:
        x, y, _ = T_board_tip.translation_m
        return SE3.from_parts(T_board_tip.rotation, [x, y, height_m])

    def _ik(self, T_board_tip: SE3) -> NDArray[np.float64]:
        return ik(self.arm, self.T_base_board @ T_board_tip)

    def _through(self, points: Sequence[NDArray[np.float64]]) -> Trajectory:
        """Return a motion through these joints, its commands found already."""
        up = self.T_base_board.matrix[:3, 2]
        plan = plan_through(self.arm, np.array(points), self.settings.limits, up=up, planner=self.planner)
        self.cell.robot.prepare({self.name: plan.trajectory})
        return plan.trajectory

    async def _capture(self) -> RgbdImage:
        with self.cell.log.span(self.name, "capture"):
            image = await self.camera.capture()
        assert isinstance(image, RgbdImage)  # the camera's model says so
        return image

    async def _perceive(self, compute: Callable[[], Result]) -> Result:
        return await self.hand.compute("perception", self.settings.perception_budget_s, compute)

    async def _survey(self, compute: Callable[[], Result]) -> Result:
        return await self.hand.compute("perception", self.settings.survey_budget_s, compute)

    async def _plan(self, compute: Callable[[], Result]) -> Result | None:
        """Plan a motion; None, with the reason in the log, where a pose or the way to it leaves the joints' ranges."""

        def attempt() -> Result | None:
            try:
                return compute()
            except TrocarError as error:
                self.cell.log.event("no motion", reason=str(error))
                return None

        return await self.hand.compute("planning", self.settings.planning_budget_s, attempt)


def _rgbd(cell: Cell) -> tuple[Camera, SE3]:
    """Return the cell's first camera with depth, and where it is registered."""
    for name, camera in cell.cameras.items():
        if isinstance(camera.model, Intrinsics):
            return camera, cell.T_world_camera_registered[name]
    raise TrocarError("peg-transfer needs an RGBD camera, and this cell has none; add one to the station")
