"""Everything on the table of a peg transfer, with its pose in the world: simulator truth."""

from __future__ import annotations

from dataclasses import dataclass, field

from trocar.geometry import SE3
from trocar.tasks.peg_transfer.shapes import Block, Pegboard


@dataclass(frozen=True, eq=False)
class PegScene:
    """A pegboard and its blocks.

    Attributes:
        T_world_board: pose of the board.
        T_world_blocks: (k,) one pose a block.
        board: the pegboard's shape.
        block: the blocks' shape.
    """

    T_world_board: SE3
    T_world_blocks: SE3
    board: Pegboard = field(default_factory=Pegboard)
    block: Block = field(default_factory=Block)
