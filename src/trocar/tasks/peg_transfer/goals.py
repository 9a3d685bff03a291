"""Goals of a peg transfer, and their outcomes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from trocar.cell import Outcome
from trocar.tasks.peg_transfer.shapes import Block, Pegboard


class Transfer(NamedTuple):
    """One goal: a block from one peg to another."""

    source: int  # peg
    target: int  # peg


THERE = tuple(Transfer(*pegs) for pegs in ((1, 7), (0, 6), (3, 8), (2, 9), (5, 11), (4, 10)))
"""The first six transfers, in the order of the paper's program; the other six go back."""
BACK = tuple(Transfer(target, source) for source, target in THERE)

PAIRS_THERE = (((0, 7), (5, 10)), ((2, 6), (3, 11)), ((1, 8), (4, 9)))
PAIRS = tuple((Transfer(*left), Transfer(*right)) for left, right in PAIRS_THERE)
PAIRS += tuple((Transfer(*left[::-1]), Transfer(*right[::-1])) for left, right in PAIRS_THERE)
"""Pairs of transfers that two arms do at once: (left arm's, right arm's). They are the paper's parallel transfers
[0, 1] -> [7, 8], [2, 3] -> [6, 11], [4, 5] -> [9, 10], paired differently: the left arm always
has the pegs further left. Neither the two sources nor the two targets are neighbours, so that the arms have room."""
GOALS = {
    "unilateral": THERE + BACK,
    "bilateral": tuple(goal for pair in PAIRS for goal in pair),
    "handover": THERE + BACK,
}
"""The twelve transfers of each variant, in order."""


def ready(goals: Sequence[Transfer]) -> list[int]:
    """Return the numbers of the goals that no earlier one of these has to precede.

    One goal precedes another if it brings the block that the other takes, or frees the peg that the other needs.
    """
    pegs = [{goal.source, goal.target} for goal in goals]
    return [number for number, own in enumerate(pegs) if not any(own & before for before in pegs[:number])]


@dataclass(frozen=True)
class PegSet:
    """Nominal shapes of board and blocks, and the variant of the task."""

    board: Pegboard = field(default_factory=Pegboard)  # shape of the pegboard
    block: Block = field(default_factory=Block)  # shape of the blocks
    variant: str = "unilateral"  # which arms do the transfers


class TransferOutcome(Outcome):
    """How a transfer ended."""

    DONE = "the block stands on its target"
    BOARD_NOT_FOUND = "the camera did not see the board where it should be"
    NO_BLOCK = "the camera saw no block where one was expected"
    OUT_OF_REACH = "no grasp or target pose lies within the arm's joint limits"
    NOT_GRASPED = "the jaws closed but the block did not come up with them"
    DROPPED = "the block left the jaws before its target"
    NOT_PLACED = "the block was released but does not stand on its target peg"
    BLOCKED = "the other arm was in the way and did not move off"
    NOT_HANDED_OVER = "the block did not go through the jaws of both arms"
    ARM_STOPPED = "an arm did not reach the end of a motion"
    NOT_MOVED = "the block stayed where it was"
