"""Perception of the peg transfer: colour and depth of one camera."""

from __future__ import annotations

from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.perception.blocks import BlockFit, find_block, find_held_block
from trocar.tasks.peg_transfer.perception.board import BoardFit, find_board
from trocar.tasks.peg_transfer.shapes import Block, Pegboard


class DepthView:
    """Board and blocks in one RGBD image. A perception of your own has these methods."""

    def find_board(self, image: RgbdImage, T_world_camera: SE3, board: Pegboard, T_world_board_guess: SE3) -> BoardFit:
        """Return the board's pose, or why it was not found."""
        return find_board(image, T_world_camera, board, T_world_board_guess)

    def find_block(self, image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block, peg: int) -> BlockFit:
        """Return the pose of the block on a peg, or why there is none."""
        return find_block(image, T_camera_board, board, block, peg)

    def find_held_block(self, image: RgbdImage, T_camera_board: SE3, block: Block, T_board_expected: SE3) -> BlockFit:
        """Return the pose of a block in an arm's jaws, or why there is none; asked only where arms hand over."""
        return find_held_block(image, T_camera_board, block, T_board_expected)
