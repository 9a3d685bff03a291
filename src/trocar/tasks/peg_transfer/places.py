"""Choice of the pose in which to release a held block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

YAWS_RAD = np.radians(np.arange(0.0, 360.0, 7.5))
"""Rotations of the tool that are tried over a peg."""
OUTER_FINGER_M = 4.5e-3
"""Distance from the tip to the middle of the open outer finger, outwards."""
FINGER_ROOM_M = 0.7e-3
"""A block is aimed this far off the middle of its peg, towards the held wall: the inner finger opens between that wall
and the peg, and opposite a wall is a corner, where the hole is 1 mm wider."""
ROOM_M = 2.5e-3
"""Clearance that is enough, so that the tool need not turn for more."""


@dataclass(frozen=True, eq=False)
class Place:
    """A pose in which to open the jaws.

    Attributes:
        T_board_tip: pose of the tip, tool vertical.
        q: (6,) joints in this pose, before cable compensation.
        room_m: smallest gap from the outer finger's middle, or from the block, to other blocks and pegs.
    """

    T_board_tip: SE3
    q: NDArray[np.float64]
    room_m: float


def held_block(T_board_tip: SE3, T_board_block: SE3, block: Block) -> SE3:
    """Return ``T_tip_block`` after the jaws have closed, which centres the wall of the block between them."""
    matrix = (T_board_tip.inverse() @ T_board_block).matrix.copy()
    matrix[0, 3] = np.sign(matrix[0, 3]) * block.wall_middle_m
    return SE3.unchecked(matrix)


def choose_place(
    arm: ArmModel,
    T_base_board: SE3,
    T_tip_block: SE3,
    board: Pegboard,
    block: Block,
    peg: int,
    others: Sequence[SE3],
    drop_m: float,
    yaw_rad: float = 0.0,
    max_roll_rad: float = np.radians(70.0),
    margin_rad: float = np.radians(5.0),
) -> Place | str:
    """Return the pose over a peg in which to release a held block, or one sentence why there is none.

    Any yaw of the block is allowed. If there is enough clearance, the tool keeps its current yaw: the residual cable
    errors are then similar at both ends of the transfer and cancel.

    Args:
        arm: the arm that holds the block.
        T_base_board: pose of the board in the arm's base.
        T_tip_block: pose of the block in the jaws.
        board: its pegs are obstacles.
        block: shape of the blocks.
        peg: the target peg.
        others: poses of the blocks on the board.
        drop_m: height of the block's lower face above the plate.
        yaw_rad: current yaw of the tool about the board's z.
        max_roll_rad: largest |roll|.
        margin_rad: margin to the wrist's limits.
    """
    foot = board.pegs_m[peg]
    near = np.linalg.norm(board.pegs_m[:, :2] - foot[:2], axis=1)
    pegs = board.pegs_m[(near > 1e-6) & (near < 0.03), :2]
    near_blocks = [T for T in others if 1e-3 < np.linalg.norm(T.translation_m[:2] - foot[:2]) < 0.03]
    blocks = np.array([T.translation_m[:2] for T in near_blocks]).reshape(-1, 2)
    best: Place | None = None
    level = SO3.between(-T_tip_block.matrix[:3, 2], [0.0, 0.0, 1.0])
    for yaw in yaw_rad + YAWS_RAD:
        upright = SO3.axis("z", yaw) @ level
        centre = upright.apply(T_tip_block.translation_m)
        height = block.height_m + drop_m - centre[2]
        x, y = hole_over(foot, SE3.from_parts(upright), T_tip_block) - centre[:2]
        pose = SE3.from_parts(upright, [x, y, foot[2] + height])
        try:
            q = ik(arm, T_base_board @ pose)
        except OutOfReach:
            continue
        wrist = zip(arm.joints[4:], q[4:], strict=True)
        if abs(q[3]) > max_roll_rad or any(not j.lower + margin_rad <= v <= j.upper - margin_rad for j, v in wrist):
            continue
        T_board_block = pose @ T_tip_block
        finger = pose.translation_m[:2] - np.sign(T_tip_block.translation_m[0]) * OUTER_FINGER_M * upright.matrix[:2, 0]
        room = min(
            float(np.min(np.linalg.norm(pegs - finger, axis=1) - board.peg_radius_m, initial=1.0)),
            float(np.min(np.linalg.norm(blocks - finger, axis=1) - block.corner_m, initial=1.0)),
            min((block.gap_m(T_board_block, other) for other in near_blocks), default=1.0),
        )
        place = Place(pose, q, room)
        if best is None or _rank(place, yaw_rad) > _rank(best, yaw_rad):
            best = place
    return best or f"no pose over peg {peg} keeps the roll and the wrist within their limits"


def hole_over(foot_m: NDArray[np.float64], T_board_tip: SE3, T_tip_block: SE3) -> NDArray[np.float64]:
    """Return where (2,) in the board's plane the middle of a held block's hole should be to have a peg in it."""
    outwards = -np.sign(T_tip_block.translation_m[0]) * T_board_tip.matrix[:2, 0]
    return np.asarray(foot_m[:2] + FINGER_ROOM_M * outwards, dtype=np.float64)


def _rank(place: Place, yaw_rad: float) -> tuple[float, float]:
    """Return the sort key of a place: clearance, then small rotation of the tool."""
    x = place.T_board_tip.matrix[:2, 0]
    return min(place.room_m, ROOM_M), float(x @ [np.cos(yaw_rad), np.sin(yaw_rad)])
