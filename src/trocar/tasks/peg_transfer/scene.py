"""Everything on the table of a peg transfer, with its pose in the world: simulator truth."""

from __future__ import annotations

from dataclasses import dataclass, field

from trocar.geometry import SE3
from trocar.lab.flaws import Flaw
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

PRINT = Flaw(
    "print",
    "deviation of pegs and blocks from their drawings: places of the pegs, sizes of both (SD)",
    "m",
    (0.0001,),
    (0.0,),
    "assumed: tolerance of printers, as for the spheres of a calibration",
    tasks=("peg-transfer",),
)
"""How well board and blocks are printed (entry point ``trocar.flaws``)."""


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
