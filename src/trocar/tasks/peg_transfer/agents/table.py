"""What the camera shows: board and blocks, shared by all arms, and one arm's looks at blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.cell import GoalOffer, Result
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.robots.arm_script import ArmScript
from trocar.tasks.peg_transfer.agents.wall import WallOpening
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome, ready
from trocar.tasks.peg_transfer.grasps import Grasp, plan_grasp
from trocar.tasks.peg_transfer.perception import depth_camera

if TYPE_CHECKING:
    from trocar.tasks.peg_transfer.agents.peg_arm import PegArm

BOARD_LOOKS = 2


class Table:
    """The board and its blocks as they were last seen.

    Attributes:
        T_world_board: pose of the board; nominal until it has been found.
        blocks: poses of the blocks in the board's frame, as last seen or placed, by peg.
        wall: how far jaws stay open on the blocks' walls.
    """

    def __init__(self, context: AgentContext):
        self.cell, self.settings, self.see = context.cell, context.settings, context.perception
        self.board, self.block = context.nominal.board, context.nominal.block
        self._name = name = depth_camera(context.cell)
        self.camera, self.T_world_camera = context.cell.cameras[name], context.cell.T_world_camera_registered[name]
        self.T_world_board = context.cell.T_world_fixture["board"]
        self.blocks: dict[int, SE3] = {}
        self.wall = WallOpening(self.settings)

    @property
    def T_camera_board(self) -> SE3:
        """Return the pose of the board in the camera."""
        return self.T_world_camera.inverse() @ self.T_world_board

    async def capture(self, hand: ArmScript) -> RgbdImage:
        """Take an image for an arm."""
        with self.cell.log.span(hand.name, "capture"):
            image = await self.camera.capture()
        assert isinstance(image, RgbdImage)  # the camera's model guarantees it
        return image

    async def find_board(self, hand: ArmScript) -> bool:
        """Find the board, which does not move in a trial, in at most two images; return whether it was found."""
        guess, found = self.cell.T_world_fixture["board"], ""
        for _ in range(BOARD_LOOKS):
            image = await self.capture(hand)
            find = partial(self.see.find_board, image, self.T_world_camera, self.board, guess)
            found = await hand.compute("perception", self.settings.survey_budget_s, find)
            if not isinstance(found, str):
                self.T_world_board = found
                self.saw(image, {"board": self.board.rim_m})
                return True
        self.cell.log.event("stopped", outcome=TransferOutcome.BOARD_NOT_FOUND.name, reason=found)
        return False

    def find_block(self, image: RgbdImage, peg: int) -> SE3 | str:
        """Return the pose of the block on a peg in an image, or why there is none."""
        return self.see.find_block(image, self.T_camera_board, self.board, self.block, peg)

    async def check(self, hand: ArmScript) -> bool:
        """Look whether the blocks are where they were set down; return whether all of them were seen there."""
        image = await self.capture(hand)
        pegs = sorted(self.blocks)
        found = await hand.compute(
            "perception", self.settings.survey_budget_s, lambda: [self.find_block(image, peg) for peg in pegs]
        )
        seen = {peg: pose for peg, pose in zip(pegs, found, strict=True) if not isinstance(pose, str)}
        missing = sorted(set(pegs) - set(seen))
        self.saw(image, {f"block on {peg}": pose.apply(self.block.rim_m) for peg, pose in seen.items()})
        self.cell.log.event("check", pegs=[*seen], missing=missing)
        return not missing

    async def choose(self, goals: Sequence[Transfer], told: Callable[[Transfer], tuple[str, str]]) -> int:
        """Return the number of the next one of these goals: the first, unless a person chooses another.

        Args:
            goals: those that are left, in the script's order.
            told: returns the arm that begins a goal, and what it does, in words.
        """
        free = ready(goals)
        return free[await self.cell.choose([GoalOffer(*told(goals[k]), self._way_m(goals[k])) for k in free])]

    def _way_m(self, goal: Transfer) -> NDArray[np.float64]:
        """Return places (4, 3) in the world from the foot of a goal's source over the pegs to that of its target."""
        feet_m = self.board.pegs_m[[goal.source, goal.target]]
        over_m = feet_m + [0.0, 0.0, 2 * self.board.peg_height_m]
        return self.T_world_board.apply(np.stack([feet_m[0], *over_m, feet_m[1]]))

    def saw(self, image: RgbdImage, rims_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Note what an image shows, for viewers: lines (n, 3) in the board's frame."""
        self.cell.log.saw(self._name, image, {name: self.T_camera_board.apply(rim) for name, rim in rims_m.items()})


class Eyes:
    """One arm's vision: the cell's camera, and the interpretation of its images for this arm."""

    def __init__(self, arm: PegArm):
        self.arm, self.table, self.settings = arm, arm.table, arm.settings

    async def see(self, source: int, failed: Sequence[int] = ()) -> Grasp | TransferOutcome:
        """Look at a peg; return how to grasp its block, avoiding grasps that have failed, or why that is impossible."""
        return await self.look(await self.table.capture(self.arm.hand), source, failed)

    async def look(self, image: RgbdImage, source: int, failed: Sequence[int] = ()) -> Grasp | TransferOutcome:
        """Return how to grasp the block on a peg in an image, as ``see`` does."""
        seen = await self._perceive(lambda: self._plan_grasp(image, source, failed))
        if source in self.table.blocks:
            rim_m = self.table.blocks[source].apply(self.table.block.rim_m)
            self.table.saw(image, {f"block on {source}": rim_m})
        if isinstance(seen, Grasp):
            return seen
        reason, outcome = seen
        self.arm.cell.log.event("no grasp", peg=source, reason=reason)
        return outcome

    def _plan_grasp(self, image: RgbdImage, source: int, failed: Sequence[int]) -> Grasp | tuple[str, TransferOutcome]:
        table, T_base_board = self.table, self.arm.motions.T_base_board
        found = table.find_block(image, source)
        if isinstance(found, str):
            table.blocks.pop(source, None)
            return found, TransferOutcome.NO_BLOCK
        table.blocks[source] = found
        others = [pose for peg, pose in table.blocks.items() if peg != source]
        grasp = plan_grasp(
            self.arm.model,
            T_base_board,
            found,
            table.board,
            table.block,
            others,
            avoid=failed,
            depth_m=self.settings.depth_m,
            hands_over=self.arm.hands_over,
        )
        return grasp if isinstance(grasp, Grasp) else (grasp, TransferOutcome.OUT_OF_REACH)

    async def see_held(self, holder: PegArm, T_board_expected: SE3) -> SE3 | None:
        """Look at a block in an arm's jaws, near its expected pose; return its pose in the board's frame, or None.

        With ``learns_offset``, the offset of the holding arm is learned from it.
        """
        image, table = await self.table.capture(self.arm.hand), self.table
        found = await self._perceive(
            lambda: table.see.find_held_block(image, table.T_camera_board, table.block, T_board_expected)
        )
        if isinstance(found, str):
            self.arm.cell.log.event("no look", arm=self.arm.name, reason=found)
            return None
        table.saw(image, {"block": found.apply(table.block.rim_m)})
        if self.settings.learns_offset:
            holder.learn_offset((found.translation_m - T_board_expected.translation_m)[:2])
        return found

    async def see_own(self, T_tip_block: SE3) -> SE3:
        """Look at the block in this arm's jaws; return its pose there, or the given one if it is not seen."""
        expected = self.arm.T_board_tip @ T_tip_block
        seen = await self.see_held(self.arm, expected)
        if seen is None:
            return T_tip_block
        off = seen.translation_m - expected.translation_m
        self.arm.cell.log.event("correction", arm=self.arm.name, off_mm=np.round(1e3 * off, 2).tolist())
        return self.arm.T_board_tip.inverse() @ seen

    async def _perceive(self, compute: Callable[[], Result]) -> Result:
        return await self.arm.hand.compute("perception", self.settings.perception_budget_s, compute)
