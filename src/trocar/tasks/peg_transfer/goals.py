"""What is to be done in a peg transfer, and how it can end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from trocar.cell import Outcome
from trocar.tasks.peg_transfer.block import Block
from trocar.tasks.peg_transfer.pegboard import Pegboard


class Transfer(NamedTuple):
    """One goal: a block from one peg to another.

    Attributes:
        source: peg.
        target: peg.
    """

    source: int
    target: int


THERE = tuple(Transfer(*pegs) for pegs in ((1, 7), (0, 6), (3, 8), (2, 9), (5, 11), (4, 10)))
"""The first six transfers (facts/peg_transfer.md); the other six go back."""
BACK = tuple(Transfer(target, source) for source, target in THERE)


@dataclass(frozen=True)
class PegSet:
    """What lies on the table, as it is sold.

    Attributes:
        board: shape of the pegboard.
        block: shape of the blocks.
    """

    board: Pegboard = field(default_factory=Pegboard)
    block: Block = field(default_factory=Block)


class TransferOutcome(Outcome):
    """How a transfer ended."""

    DONE = "the block stands on its target"
    BOARD_NOT_FOUND = "the camera did not see the board where it should be"
    NO_BLOCK = "the camera saw no block where one was expected"
    OUT_OF_REACH = "no grasp or target pose lies within the arm's joint limits"
    NOT_GRASPED = "the jaws closed but the block did not come up with them"
    DROPPED = "the block left the jaws before its target"
    NOT_PLACED = "the block was released but does not stand on its target peg"
    BLOCKED = "the other arm was in the way, and did not go"
    ARM_STOPPED = "an arm did not come to the end of a motion"
    NOT_MOVED = "the block stayed where it was"
