"""What the referee of a peg transfer saw: simulator truth, only for the score. No agent may import this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

ENGAGED_M = 8e-3
"""A block is on its peg while its lower face is below this height over the plate, the peg inside its hole."""
UPRIGHT_RAD = np.radians(10.0)


@dataclass(frozen=True, eq=False)
class PegTruth:
    """The true poses of everything.

    Attributes:
        times_s: (n,) trial clock.
        T_board_blocks: poses (n, k) in the board's frame.
        held: (n, k) whether both fingers of an arm touch the block.
        p_board_tips: (n, 3) true tip of each arm in the board's frame, m, by name.
        board: the pegboard's shape.
        block: the blocks' shape.
        held_by: the same as ``held`` for each arm separately, by name.
    """

    times_s: NDArray[np.float64]
    T_board_blocks: SE3
    held: NDArray[np.bool_]
    p_board_tips: dict[str, NDArray[np.float64]]
    board: Pegboard
    block: Block
    held_by: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def pegs(self) -> NDArray[np.intp]:
        """Return for each time and block (n, k) the peg round which it stands upright, -1 if there is none."""
        return pegs_under(self.T_board_blocks, self.board, self.block)


def pegs_under(T_board_blocks: SE3, board: Pegboard, block: Block) -> NDArray[np.intp]:
    """Return for each pose (...,) of a block the peg that is inside its hole while it stands, or -1."""
    poses = T_board_blocks.matrix
    height = poses[..., 2, 3] - block.height_m
    standing = (-poses[..., 2, 2] > np.cos(UPRIGHT_RAD)) & (height < ENGAGED_M)
    middles = board.pegs_m + [0.0, 0.0, board.peg_height_m / 2]
    away = np.linalg.norm(poses[..., None, :2, 3] - middles[:, :2], axis=-1)
    nearest = away.argmin(axis=-1)
    offset = T_board_blocks.inverse().apply(middles[nearest])
    radius = np.hypot(offset[..., 0], offset[..., 1])
    inside = radius < block.hole_radius_m(np.arctan2(offset[..., 1], offset[..., 0]))
    return np.where(standing & inside, nearest, -1)
