"""Objects on the table of a peg transfer, drawn at random for each trial: simulator truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from trocar.geometry import SE3, SO3, TURN
from trocar.lab import Station
from trocar.lab.flaws import Flaw
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

BOARD_SHIFT_M = 2e-3
BOARD_TURN_RAD = np.radians(3.0)
BLOCK_SHIFT_M = 1.6e-3
"""Largest distance of a laid-down block from the axis of its peg; the hole's clearance is 2.1 mm."""
BESIDE_PEG_M = 0.2e-3
"""Least gap between a block as laid down and its peg."""
MOST_OFF_M = 0.5e-3
"""Printing errors are clipped to this: nobody would use a worse print."""
MIN_GAP_M = 0.5e-3
"""Least gap between two blocks as laid down at the start."""
PRINT = Flaw(
    "print",
    "deviation of pegs and blocks from their drawings: places of the pegs, sizes of both (SD)",
    "m",
    (0.0001,),
    (0.0,),
    "assumed: tolerance of printers, as for the spheres of a calibration",
    tasks=("peg-transfer",),
)
"""Printing errors of board and blocks (entry point ``trocar.flaws``)."""


@dataclass(frozen=True, eq=False)
class PegScene:
    """A pegboard and its blocks.

    Attributes:
        T_world_board: pose of the board.
        T_world_blocks: (k,) pose of each block.
        board: the pegboard's shape.
        block: the blocks' shape.
    """

    T_world_board: SE3
    T_world_blocks: SE3
    board: Pegboard = field(default_factory=Pegboard)
    block: Block = field(default_factory=Block)


def draw_scene(rng: np.random.Generator, station: Station) -> PegScene:
    """Return a board displaced by millimetres, with a block lying loosely on each of its six left pegs."""
    (sd_m,) = station.difficulty.values(PRINT)
    board, block = _printed(float(sd_m), rng.spawn(1)[0])
    shift = np.append(rng.uniform(-BOARD_SHIFT_M, BOARD_SHIFT_M, 2), 0.0)
    turn = SO3.axis("z", rng.uniform(-BOARD_TURN_RAD, BOARD_TURN_RAD))
    T_world_board = station.T_world_fixture["board"] @ SE3.from_parts(turn, shift)
    room_m = float(block.hole_radius_m(np.linspace(0.0, TURN, 61)).min()) - board.peg_radius_m
    shift_m, poses = min(BLOCK_SHIFT_M, room_m - BESIDE_PEG_M), list[SE3]()
    for peg in board.pegs_m[:6]:
        pose = _laid(block, peg, shift_m, rng)
        while any(block.gap_m(pose, other) < MIN_GAP_M for other in poses):
            pose = _laid(block, peg, shift_m, rng)
        poses.append(pose)
    T_board_blocks = SE3.unchecked(np.stack([pose.matrix for pose in poses]))
    return PegScene(T_world_board, T_world_board @ T_board_blocks, board, block)


def _printed(sd_m: float, rng: np.random.Generator) -> tuple[Pegboard, Block]:
    """Return a board and a block with printing errors of this SD in positions and sizes, at most 0.5 mm.

    All pegs have the same thickness and height, and all blocks the same shape.
    """

    def off(*shape: int) -> np.ndarray:
        return np.clip(sd_m * rng.standard_normal(shape), -MOST_OFF_M, MOST_OFF_M)

    board, block = Pegboard(), Block()
    thicker, taller, side, corner, height, wider = off(6).tolist()
    pegs = tuple(map(tuple, off(len(board.pegs_m), 2).tolist()))
    board = replace(
        board, peg_radius_m=board.peg_radius_m + thicker, peg_height_m=board.peg_height_m + taller, pegs_off_m=pegs
    )
    block = replace(
        block,
        side_m=block.side_m + side,
        corner_m=block.corner_m + corner,
        height_m=block.height_m + height,
        hole_wider_m=wider,
    )
    return board, block


def _laid(block: Block, peg_m: np.ndarray, shift_m: float, rng: np.random.Generator) -> SE3:
    """Return a random pose of a block round a peg in the board's frame: any yaw, up to ``shift_m`` off its axis."""
    off = shift_m * np.sqrt(rng.uniform())
    angle = rng.uniform(0.0, TURN)
    place = peg_m + [off * np.cos(angle), off * np.sin(angle), block.height_m]
    return SE3.from_parts(SO3.axis("x", np.pi) @ SO3.axis("z", rng.uniform(0.0, TURN)), place)
