"""What the camera tells about the table: where the board and its blocks are. All arms of a script share it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import trio

from trocar.cell import Camera, Cell, Result
from trocar.errors import TrocarError
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.robots.arm_script import ArmScript
from trocar.tasks.peg_transfer.goals import TransferOutcome

BOARD_LOOKS = 2


class Table:
    """The board and its blocks as they were last seen.

    Attributes:
        T_world_board: pose of the board; nominal until it has been found.
        blocks: poses of the blocks in the board's frame, as last seen or placed, by peg.
    """

    def __init__(self, context: AgentContext):
        self.cell, self.settings, self.see = context.cell, context.settings, context.perception
        self.board, self.block = context.nominal.board, context.nominal.block
        self.camera, self.T_world_camera = _rgbd(context.cell)
        self.T_world_board = context.cell.T_world_fixture["board"]
        self.blocks: dict[int, SE3] = {}
        self._sensor = trio.Lock()

    @property
    def T_camera_board(self) -> SE3:
        """Return the pose of the board in the camera."""
        return self.T_world_camera.inverse() @ self.T_world_board

    async def capture(self, hand: ArmScript) -> RgbdImage:
        """Take an image for an arm; the sensor takes one at a time."""
        with self.cell.log.span(hand.name, "capture"):
            async with self._sensor:
                image = await self.camera.capture()
        assert isinstance(image, RgbdImage)  # the camera's model guarantees it
        return image

    async def find_board(self, hand: ArmScript) -> bool:
        """Register the board once, since it does not move in a trial; return whether two looks at most found it."""
        guess, reason = self.cell.T_world_fixture["board"], ""
        for _ in range(BOARD_LOOKS):
            image = await self.capture(hand)
            find = partial(self.see.find_board, image, self.T_world_camera, self.board, guess)
            fit = await self._survey(hand, find)
            if fit.found:
                self.T_world_board = fit.T_world_board
                return True
            reason = fit.reason
        self.cell.log.event("stopped", outcome=TransferOutcome.BOARD_NOT_FOUND.name, reason=reason)
        return False

    async def check(self, hand: ArmScript) -> bool:
        """Look whether the blocks are where they were set down; return whether all are, and were seen.

        Blocks that were picked again were checked then.
        """
        image = await self.capture(hand)
        pegs = sorted(self.blocks)
        fits = await self._survey(
            hand, lambda: [self.see.find_block(image, self.T_camera_board, self.board, self.block, peg) for peg in pegs]
        )
        seen = [peg for peg, fit in zip(pegs, fits, strict=True) if fit.found]
        missing = sorted(set(pegs) - set(seen))
        self.cell.log.event("check", pegs=seen, missing=missing)
        return not missing

    async def _survey(self, hand: ArmScript, compute: Callable[[], Result]) -> Result:
        return await hand.compute("perception", self.settings.survey_budget_s, compute)


def _rgbd(cell: Cell) -> tuple[Camera, SE3]:
    """Return the cell's first camera with depth, and where it is registered."""
    for name, camera in cell.cameras.items():
        if isinstance(camera.model, Intrinsics):
            return camera, cell.T_world_camera_registered[name]
    raise TrocarError("peg-transfer needs an RGBD camera, and this cell has none; add one to the station")
