"""How one arm looks at blocks: on their pegs, to grasp them, and in the jaws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from trocar.cell import Result
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.agents.settings import GRASP_RULES, OUTER_RULES
from trocar.tasks.peg_transfer.goals import TransferOutcome
from trocar.tasks.peg_transfer.grasps import Grasp, Jaws, choose_grasp

if TYPE_CHECKING:
    from trocar.tasks.peg_transfer.agents.peg_arm import PegArm


class Eyes:
    """One arm's vision: the cell's camera, and the interpretation of its images for this arm.

    Args:
        arm: the arm.
    """

    def __init__(self, arm: PegArm):
        self.arm, self.table, self.settings = arm, arm.table, arm.settings

    async def see(self, source: int, failed: Sequence[int] = ()) -> Grasp | TransferOutcome:
        """Look at a peg; return how to grasp its block, avoiding grasps that have failed, or why it cannot be."""
        return await self.look(await self._capture(), source, failed)

    async def look(self, image: RgbdImage, source: int, failed: Sequence[int] = ()) -> Grasp | TransferOutcome:
        """Return how to grasp the block on a peg in an image, avoiding grasps that have failed, or why it cannot be."""
        seen = await self._perceive(lambda: self._plan_grasp(image, source, failed))
        if isinstance(seen, Grasp):
            return seen
        reason, outcome = seen
        self.arm.cell.log.event("no grasp", peg=source, reason=reason)
        return outcome

    def _plan_grasp(self, image: RgbdImage, source: int, failed: Sequence[int]) -> Grasp | tuple[str, TransferOutcome]:
        table, settings = self.table, self.settings
        fit = table.see.find_block(image, table.T_camera_board, table.board, table.block, source)
        if not fit.found or fit.T_board_block is None:
            table.blocks.pop(source, None)
            return fit.reason, TransferOutcome.NO_BLOCK
        table.blocks[source] = fit.T_board_block
        others = [pose.matrix for peg, pose in table.blocks.items() if peg != source]
        neighbours = SE3.unchecked(np.array(others)) if others else None
        refusal = ""
        own_side = self.arm.motions.T_base_board.inverse().translation_m[:2]
        for outer, min_gap_m, max_roll_rad in OUTER_RULES if self.arm.hands_over else GRASP_RULES:
            grasp = choose_grasp(
                self.arm.model,
                self.arm.motions.T_base_board,
                fit.T_board_block,
                table.board,
                table.block,
                neighbours,
                avoid=failed,
                depth_m=settings.depth_m,
                jaws=replace(Jaws.of(self.arm.model.instrument), min_gap_m=min_gap_m),
                max_roll_rad=max_roll_rad,
                towards=own_side if outer else None,
            )
            if isinstance(grasp, Grasp):
                return grasp
            refusal = grasp.reason
        return refusal, TransferOutcome.OUT_OF_REACH

    async def see_held(self, T_board_expected: SE3) -> SE3 | None:
        """Look at a block in an arm's jaws; return its pose in the board's frame, nearly upright, or None.

        Args:
            T_board_expected: where it is according to the arm's joints.
        """
        image, table = await self._capture(), self.table
        fit = await self._perceive(
            lambda: table.see.find_held_block(image, table.T_camera_board, table.block, T_board_expected)
        )
        if fit.T_board_block is None:
            self.arm.cell.log.event("no look", arm=self.arm.name, reason=fit.reason)
            return None
        return fit.T_board_block

    async def see_own(self, T_tip_block: SE3) -> SE3:
        """Look at the block in this arm's jaws; return its pose there, or the expected one if it is not seen."""
        tip = self.arm.T_board_tip
        seen = await self.see_held(tip @ T_tip_block)
        if seen is None:
            return T_tip_block
        off = seen.translation_m - (tip @ T_tip_block).translation_m
        self.arm.cell.log.event("correction", arm=self.arm.name, off_mm=np.round(1e3 * off, 2).tolist())
        return tip.inverse() @ seen

    async def _capture(self) -> RgbdImage:
        return await self.table.capture(self.arm.hand)

    async def _perceive(self, compute: Callable[[], Result]) -> Result:
        """Compute on an image."""
        return await self.arm.hand.compute("perception", self.settings.perception_budget_s, compute)
