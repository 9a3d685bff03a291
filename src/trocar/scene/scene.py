"""Everything on the table, with its pose in the world."""

from __future__ import annotations

from dataclasses import dataclass

from trocar.geometry import SE3
from trocar.scene.block import Block
from trocar.scene.pegboard import Pegboard


@dataclass(frozen=True)
class Scene:
    """A pegboard and its blocks.

    Attributes:
        board: the pegboard's shape.
        block: the blocks' shape.
        T_world_board: pose of the board.
        T_world_blocks: one pose a block (batch of n).
    """

    board: Pegboard
    block: Block
    T_world_board: SE3
    T_world_blocks: SE3
